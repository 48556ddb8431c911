"""COLMAP models. pycolmap is the judge of what is read and of what is written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from camera_sets import largest_difference, some_cameras
from small_colmap import CAMERAS, FILES, IMAGES, POINTS, write_files, write_small_for_binary

from datasets.colmap import ColmapModel, read_colmap_model, write_colmap_text
from gvr_core.cameras import Camera


def as_judged(folder: Path) -> list[tuple[str, Camera]]:
    """The cameras of a model as pycolmap reads it, in name order."""
    model = pycolmap.Reconstruction(str(folder))
    images = []
    for image in model.images.values():
        pose = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
        camera = image.camera
        K = camera.calibration_matrix()
        images.append((image.name, Camera(K, pose, camera.width, camera.height)))
    return sorted(images, key=lambda pair: pair[0])


def cameras_of(model: ColmapModel) -> list[tuple[str, Camera]]:
    return list(model.cameras.items())


@pytest.fixture
def small(tmp_path: Path) -> Path:
    return write_files(tmp_path, cameras=CAMERAS, images=IMAGES, points3D=POINTS)


def test_small_text_model(small: Path):
    model = read_colmap_model(small)
    assert list(model.cameras) == ["a first.jpg", "b/second.jpg"]
    first, second = model.cameras.values()
    np.testing.assert_array_equal(first.K, [[50, 0, 32], [0, 50, 24], [0, 0, 1]])
    assert (first.width, first.height) == (64, 48)
    # The quaternion (0, 2, 0, 0) is half a turn about x.
    np.testing.assert_allclose(
        first.world_to_camera, [[1, 0, 0, 1], [0, -1, 0, 2], [0, 0, -1, 3], [0, 0, 0, 1]]
    )
    np.testing.assert_array_equal(second.K, [[500, 0, 320], [0, 501, 240], [0, 0, 1]])
    np.testing.assert_array_equal(model.points3D, [[0.5, -1, 2e-3], [1, 2, 3]])
    np.testing.assert_array_equal(model.colours, [[10, 20, 255], [0, 0, 0]])


def test_real_model_against_pycolmap(shared: Path):
    folder = shared / "data" / "plush" / "sparse" / "0"
    model = read_colmap_model(folder)
    assert len(model.cameras) == 97
    assert largest_difference(cameras_of(model), as_judged(folder)) < 1e-9
    points = pycolmap.Reconstruction(str(folder)).points3D
    assert len(model.points3D) == len(points) == 25_784
    # The file's ids count from 1 in the order of its lines.
    want = np.stack([points[i].xyz for i in range(1, len(points) + 1)])
    np.testing.assert_array_equal(model.points3D, want)
    want_colours = np.stack([points[i].color for i in range(1, len(points) + 1)])
    np.testing.assert_array_equal(model.colours, want_colours)


def test_binary_that_pycolmap_wrote(shared: Path, tmp_path: Path):
    folder = shared / "data" / "plush" / "sparse" / "0"
    text = read_colmap_model(folder)
    pycolmap.Reconstruction(str(folder)).write_binary(str(tmp_path))
    binary = read_colmap_model(tmp_path)
    assert largest_difference(cameras_of(binary), cameras_of(text)) < 1e-12
    got = np.hstack([binary.points3D, binary.colours])
    want = np.hstack([text.points3D, text.colours])
    np.testing.assert_array_equal(got[np.lexsort(got.T)], want[np.lexsort(want.T)])


def test_binary_points_with_tracks(shared: Path, small: Path):
    """The points of the same scene as they left COLMAP, each with the images that saw it."""
    source = shared / "data" / "plush" / "sparse" / "points3D_original_with_tracks.bin"
    pycolmap.Reconstruction(str(write_small_for_binary(small))).write_binary(str(small))
    (small / "points3D.bin").write_bytes(source.read_bytes())
    got = read_colmap_model(small).points3D
    want = read_colmap_model(shared / "data" / "plush" / "sparse" / "0").points3D
    np.testing.assert_allclose(got[np.lexsort(got.T)], want[np.lexsort(want.T)], atol=1e-12)


def test_binary_is_preferred_as_in_colmap(small: Path):
    pycolmap.Reconstruction(str(write_small_for_binary(small))).write_binary(str(small))
    write_files(small, images="nothing that could be read\n")
    assert list(read_colmap_model(small).cameras) == ["a_first.jpg", "b/second.jpg"]


@pytest.mark.parametrize("seed", range(5))
def test_what_is_written_is_read_by_us_and_by_pycolmap(tmp_path: Path, seed: int):
    rng = np.random.default_rng(seed)
    images = some_cameras(seed=seed)
    points, colours = rng.normal(size=(30, 3)), rng.integers(0, 256, (30, 3))
    write_colmap_text(tmp_path / "new", images, points, colours)
    model = read_colmap_model(tmp_path / "new")
    assert largest_difference(cameras_of(model), images) < 1e-12
    assert largest_difference(as_judged(tmp_path / "new"), images) < 1e-9
    np.testing.assert_array_equal(model.points3D, points)
    np.testing.assert_array_equal(model.colours, colours)
    assert len(pycolmap.Reconstruction(str(tmp_path / "new")).cameras) == 2
    assert {path.name for path in (tmp_path / "new").iterdir()} == {f"{f}.txt" for f in FILES}


def test_points_are_optional(small: Path):
    (small / "points3D.txt").unlink()
    model = read_colmap_model(small)
    assert model.points3D is None
    assert model.colours is None
    write_colmap_text(small, some_cameras())
    assert read_colmap_model(small).points3D.shape == (0, 3)


def test_the_last_image_may_lack_its_line_of_points(small: Path):
    write_files(small, images="1 1 0 0 0 0 0 0 1 a.jpg\n\n2 1 0 0 0 0 0 0 1 b.jpg")
    assert list(read_colmap_model(small).cameras) == ["a.jpg", "b.jpg"]
