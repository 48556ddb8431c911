"""Where the cameras of a capture are looked for, and which go first."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from camera_sets import largest_difference
from small_captures import (
    ITERATION,
    SCENE,
    Named,
    some_gaussians,
    some_views,
    stems,
    write_capture,
    write_pictures,
)
from transforms_files import nerfstudio, save

from datasets.camera_checks import DistortedCameraError
from datasets.capture import Capture, read_capture, read_images
from datasets.colmap import read_colmap_model, write_colmap_text
from datasets.inria_cameras import write_inria_cameras
from gvr_core.splat_io import write_ply


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_capture(tmp_path / SCENE)


@pytest.fixture
def views() -> Named:
    return some_views()


def read(folder: Path, **named: Path) -> Capture:
    return read_capture(folder, SCENE, **named)


def found(folder: Path) -> Named:
    return [(image.name, image.camera) for image in read_images(folder).images]


@pytest.mark.parametrize("place", ["sparse/0", "sparse", "colmap/sparse/0"])
def test_places_of_colmap(tmp_path: Path, views: Named, place: str):
    write_colmap_text(tmp_path / place, views)
    write_pictures(tmp_path / "images", views)
    assert largest_difference(found(tmp_path), views) < 1e-12


@pytest.mark.parametrize("place", ["cameras.json", "output/cameras.json"])
def test_inria_names_get_their_pictures_endings(tmp_path: Path, views: Named, place: str):
    (tmp_path / place).parent.mkdir(exist_ok=True)
    write_inria_cameras(tmp_path / place, stems(views[::-1]))
    write_pictures(tmp_path / "images", views)
    assert largest_difference(found(tmp_path), views) < 1e-12
    assert read_images(tmp_path).notes == ()


def test_the_cameras_beside_a_splat_that_lies_elsewhere(tmp_path: Path, views: Named):
    write_pictures(tmp_path / "scene" / "images", views)
    write_ply(tmp_path / "splats" / "ramen" / ITERATION.format(7), some_gaussians())
    inria = tmp_path / "splats" / "ramen" / "cameras.json"
    write_inria_cameras(inria, stems(views))
    capture = read(tmp_path / "scene", splats=tmp_path / "splats")
    assert capture.camera_files == (inria,)
    assert [image.path for image in capture.images] == [
        tmp_path / "scene" / "images" / name for name, _ in views
    ]


def test_colmap_goes_first_and_the_notes_say_so(folder: Path, views: Named):
    moved = [(name, camera.resized(camera.width, camera.height)) for name, camera in views[1:]]
    write_inria_cameras(folder / "cameras.json", stems(moved))
    save(folder / "transforms.json", nerfstudio(moved))
    capture = read(folder)
    assert len(capture.images) == len(views)
    assert capture.notes == (
        "cameras are taken from sparse/0, not from cameras.json, transforms.json",
    )


def test_transforms_json_names_its_own_folder_of_pictures(tmp_path: Path, views: Named):
    small = [(n, c.resized(c.width // 2, c.height // 2)) for n, c in views]
    content = json.loads(json.dumps(nerfstudio(small)).replace("./images/", "images_2/"))
    save(tmp_path / "transforms.json", content)
    write_pictures(tmp_path / "images", views)
    write_pictures(tmp_path / "images_2", small)
    captured = read_images(tmp_path)
    assert largest_difference([(i.name, i.camera) for i in captured.images], small) < 1e-9
    assert captured.images[0].path == tmp_path / "images_2" / views[0][0]
    assert captured.notes == ()


@pytest.mark.parametrize("name", ["undistorted", "dense", "dense/0"])
def test_an_undistorted_copy_stands_in(folder: Path, views: Named, name: str):
    distort(folder / "sparse" / "0")
    with pytest.raises(DistortedCameraError, match=r"k1 -0\.02.*colmap image_undistorter.*dense/"):
        read(folder)
    smaller = [(n, c.resized(c.width - 2, c.height - 1)) for n, c in views]
    write_colmap_text(folder / name / "sparse", smaller)
    write_pictures(folder / name / "images", smaller)
    capture = read(folder)
    assert largest_difference([(i.name, i.camera) for i in capture.images], smaller) < 1e-12
    assert capture.images[0].path == folder / name / "images" / smaller[0][0]
    assert capture.notes == (
        f"sparse/0 has distortion: cameras and pictures are taken from {name}",
    )


def distort(model: Path, coefficient: str = "-0.02") -> None:
    """Every camera as SIMPLE_RADIAL with that coefficient."""
    lines = []
    for line in (model / "cameras.txt").read_text().splitlines():
        if not line.startswith("#"):
            number, _, width, height, fx, _, cx, cy = line.split()
            line = f"{number} SIMPLE_RADIAL {width} {height} {fx} {cx} {cy} {coefficient}"
        lines.append(line)
    (model / "cameras.txt").write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("model", "parameters", "zeros"),
    [
        ("SIMPLE_RADIAL", "80 32 24", 1),
        ("RADIAL", "80 32 24", 2),
        ("OPENCV", "80 81 32 24", 4),
        ("FULL_OPENCV", "80 81 32 24", 8),
    ],
)
def test_a_distortion_of_zero_is_none(tmp_path: Path, model: str, parameters: str, zeros: int):
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
    text = f"1 {model} 64 48 {parameters}"
    (tmp_path / "cameras.txt").write_text(text + " 0" * zeros + "\n")
    camera = read_colmap_model(tmp_path).cameras["a.png"]
    fy = 81 if "OPENCV" in model else 80
    np.testing.assert_array_equal(camera.K, [[80, 0, 32], [0, fy, 24], [0, 0, 1]])
    for bent in range(zeros):
        numbers = ["0"] * zeros
        numbers[bent] = "1e-7"
        (tmp_path / "cameras.txt").write_text(f"{text} {' '.join(numbers)}\n")
        with pytest.raises(DistortedCameraError, match=f"{model} with distortion: .. 1e-07"):
            read_colmap_model(tmp_path)


@pytest.mark.parametrize("model", ["OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE"])
def test_a_fisheye_is_no_pinhole_even_with_coefficients_of_zero(tmp_path: Path, model: str):
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
    count = 8 if model == "OPENCV_FISHEYE" else 4
    (tmp_path / "cameras.txt").write_text(f"1 {model} 64 48 80 80 32 24{' 0' * (count - 4)}\n")
    with pytest.raises(DistortedCameraError, match=model):
        read_colmap_model(tmp_path)
