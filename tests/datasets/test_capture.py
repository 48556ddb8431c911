"""Splat, cameras and photographs of a folder belong together."""

from __future__ import annotations

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
    write_capture,
    write_pictures,
)

from datasets.capture import Capture, read_capture, read_images
from datasets.colmap import write_colmap_text
from datasets.images import write_png
from datasets.inria_cameras import write_inria_cameras
from gvr_core.cameras import Camera
from gvr_core.errors import CameraFormatError, DatasetError, GVRError


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


def test_an_ordinary_folder(folder: Path, views: Named):
    capture = read(folder)
    assert capture.ply == folder / ITERATION.format(30000)
    np.testing.assert_array_equal(capture.gaussians.means, some_gaussians().means)
    assert largest_difference([(i.name, i.camera) for i in capture.images], views) < 1e-12
    assert [image.path for image in capture.images] == [folder / "images" / n for n, _ in views]
    assert capture.camera_files == tuple(
        folder / "sparse/0" / f for f in ("cameras.txt", "images.txt")
    )
    assert (capture.unregistered, capture.notes) == ((), ())


@pytest.mark.parametrize("factor", [2, 4, 8])
def test_pictures_scaled_down_rescale_their_cameras(folder: Path, views: Named, factor: int):
    write_pictures(folder / "images", views[:3], factor)
    capture = read(folder)
    for image, (_, camera) in zip(capture.images[:3], views, strict=False):
        assert (image.camera.width, image.camera.height) == (
            round(camera.width / factor),
            round(camera.height / factor),
        )
        pixels, _ = image.camera.project([[0, 0, 0.3]])
        whole, _ = camera.project([[0, 0, 0.3]])
        size = np.array([image.camera.width, image.camera.height])
        np.testing.assert_allclose(pixels / size, whole / (camera.width, camera.height), rtol=1e-12)
    assert capture.images[3].camera.width == views[3][1].width
    assert capture.notes == (
        f"3 pictures have 1/{factor} of their cameras' size: cameras rescaled",
    )


def test_odd_sizes_may_be_rounded_either_way(tmp_path: Path, views: Named):
    K = np.array([[80.0, 0, 49.5], [0, 90, 24.5], [0, 0, 1]])  # pixels that are not square
    odd = [("a.png", Camera(K, views[0][1].world_to_camera, 99, 49))]
    write_colmap_text(tmp_path / "sparse", odd)
    for width, height in ((49, 24), (50, 25), (49, 25)):
        write_png(tmp_path / "images" / "a.png", np.zeros((height, width, 3), np.uint8))
        (image,) = read_images(tmp_path).images
        assert (image.camera.width, image.camera.height) == (width, height)
        np.testing.assert_allclose(image.camera.K[0], [80 * width / 99, 0, width / 2])
        np.testing.assert_allclose(image.camera.K[1], [0, 90 * height / 49, height / 2])


def test_only_scaled_copies(folder: Path, views: Named):
    (folder / "images").rename(folder / "originals")
    write_pictures(folder / "images_8", views, 8)
    write_pictures(folder / "images_4", views, 4)
    capture = read(folder)
    assert capture.images[0].path == folder / "images_4" / views[0][0]
    assert capture.notes == (
        "no folder images: pictures are taken from images_4",
        "4 pictures have 1/4 of their cameras' size: cameras rescaled",
    )


@pytest.mark.parametrize("change", [(1, 0), (0, -1), (-3, 5), "half the width", "turned", "double"])
def test_pictures_of_another_size_are_refused(folder: Path, views: Named, change: object):
    name, camera = views[2]
    sizes = {
        "half the width": (camera.width // 2, camera.height),
        "turned": (camera.height, camera.width),
        "double": (2 * camera.width, 2 * camera.height),
    }
    size = sizes.get(str(change)) or (camera.width + change[0], camera.height + change[1])
    write_png(folder / "images" / name, np.zeros((size[1], size[0], 3), np.uint8))
    with pytest.raises(DatasetError, match=f"the picture has {size[0]} x {size[1]}") as caught:
        read(folder)
    assert caught.value.path == str(folder / "images" / name)
    assert f"{camera.width} x {camera.height}" in str(caught.value.accepted)


def test_pictures_without_cameras_and_cameras_without_pictures(folder: Path, views: Named):
    images = folder / "images"
    (images / views[1][0]).rename(images / "extra.png")
    write_png(images / "more" / "x.JPG", np.zeros((5, 5, 3), np.uint8))
    (images / ".hidden.png").touch()
    (images / "notes.txt").touch()
    capture = read(folder)
    assert capture.unregistered == ("extra.png", "more/x.JPG")
    assert [image.name for image in capture.images if image.path is None] == [views[1][0]]
    assert capture.notes == (f"1 of 4 registered images have no picture: {views[1][0]}",)


def test_no_pictures_at_all(folder: Path, views: Named):
    (folder / "images").rename(folder / "frames")
    capture = read(folder)
    assert largest_difference([(i.name, i.camera) for i in capture.images], views) < 1e-12
    assert all(image.path is None for image in capture.images)
    assert capture.notes == ("no folder of pictures (images, images_2, images_4, images_8)",)


def test_pictures_with_another_ending(folder: Path, views: Named):
    images = folder / "images"
    for name, _ in views[:2]:
        (images / name).rename(images / Path(name).with_suffix(".PNG").name)
    capture = read(folder)
    assert [image.name for image in capture.images] == [
        *(Path(name).with_suffix(".PNG").name for name, _ in views[:2]),
        *(name for name, _ in views[2:]),
    ]
    assert capture.notes == ("2 pictures have another ending than their cameras say",)


def test_ambiguous_pictures_are_refused(tmp_path: Path, views: Named):
    write_inria_cameras(tmp_path / "cameras.json", [("v00", views[0][1])])
    write_pictures(tmp_path / "images", [("v00.png", views[0][1]), ("left/v00.png", views[0][1])])
    assert [name for name, _ in found(tmp_path)] == ["v00.png"]  # the whole path goes first
    (tmp_path / "images" / "v00.png").rename(tmp_path / "images" / "left" / "v00.PNG")
    with pytest.raises(DatasetError, match=r"'v00' may mean left/v00\.PNG, left/v00\.png"):
        read_images(tmp_path)


def test_two_cameras_of_one_picture_are_refused(tmp_path: Path, views: Named):
    write_colmap_text(tmp_path / "sparse", [("a.jpg", views[0][1]), ("a.png", views[1][1])])
    write_pictures(tmp_path / "images", [("a.png", views[0][1])])
    with pytest.raises(DatasetError, match=r"cameras of 'a.png' and 'a.jpg' mean this picture"):
        read_images(tmp_path)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:20])


def test_broken_folders(folder: Path, tmp_path: Path, views: Named):
    with pytest.raises(DatasetError, match="no such folder"):
        read(tmp_path / "nowhere")
    with pytest.raises(DatasetError, match="no such folder"):
        read(folder / "sparse/0/images.txt")
    cut(folder / "images" / views[0][0])
    with pytest.raises(DatasetError, match="cannot be decoded: "):
        read(folder)
    write_pictures(folder / "images", views)
    (folder / "sparse/0/images.txt").write_text("1 nan 0 0 0 0 0 0 1 v00.png\n\n")
    with pytest.raises(CameraFormatError, match="rotation"):
        read(folder)
    (folder / "sparse/0/images.txt").unlink()
    with pytest.raises(CameraFormatError, match=r"no cameras in this folder.*transforms\.json"):
        read(folder)
    (folder / "cameras.json").write_text("[{]")
    with pytest.raises(GVRError, match="Invalid JSON"):
        read(folder)
