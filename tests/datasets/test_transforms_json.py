"""``transforms.json`` of nerfstudio and instant-ngp."""

from __future__ import annotations

import copy
import json
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_sets import largest_difference, some_cameras
from hypothesis import given, settings
from hypothesis import strategies as st
from transforms_files import instant_ngp, nerfstudio, opengl, save

from datasets.camera_checks import DistortedCameraError
from datasets.cameras_file import find_cameras, read_cameras
from datasets.colmap import write_colmap_text
from datasets.images import write_png
from datasets.transforms_json import read_transforms_json
from gvr_core.cameras import Camera
from gvr_core.errors import CameraFormatError, GVRError

IMAGES = some_cameras()
ALIKE = [(name, camera) for name, camera in IMAGES if camera.width == 640]

FRAME: dict[str, Any] = {
    "file_path": "images/a.png",
    # Looks along +x from (1, 2, 3), up is +z: the columns are the camera's axes in the world.
    "transform_matrix": [[0, 0, -1, 1], [-1, 0, 0, 2], [0, 1, 0, 3.0], [0, 0, 0, 1]],
}
FILE: dict[str, Any] = {"fl_x": 80.0, "fl_y": 81, "cx": 49, "cy": 31, "w": 100, "h": 60}


def content(**changes: Any) -> dict[str, Any]:
    """A file of one frame; ``...`` removes a key."""
    whole = {**copy.deepcopy(FILE), "frames": [copy.deepcopy(FRAME)], **changes}
    return {key: value for key, value in whole.items() if value is not ...}


def framed(**changes: Any) -> dict[str, Any]:
    """The same with a second frame, changed."""
    other = {**copy.deepcopy(FRAME), "file_path": "images/b.png", **changes}
    kept = {key: value for key, value in other.items() if value is not ...}
    return content(frames=[copy.deepcopy(FRAME), kept])


def without_folder(cameras: list[tuple[str, Camera]]) -> list[tuple[str, Camera]]:
    return [(name.removeprefix("images/"), camera) for name, camera in cameras]


def test_one_camera(tmp_path: Path):
    ((name, camera),) = read_transforms_json(save(tmp_path / "t.json", content()))
    assert name == "images/a.png"
    np.testing.assert_array_equal(camera.K, [[80, 0, 49], [0, 81, 31], [0, 0, 1]])
    assert (camera.width, camera.height) == (100, 60)
    np.testing.assert_allclose(camera.position, [1, 2, 3])
    np.testing.assert_allclose(camera.forward, [1, 0, 0])
    # A point to the left of the view (+y) and above it (+z), in front.
    np.testing.assert_allclose(camera.to_camera([11, 3, 5]), [-1, -2, 10], atol=1e-12)


@pytest.mark.parametrize("scale", [1.0, 0.37])
def test_nerfstudio_reads_back_to_the_same_poses(tmp_path: Path, scale: float):
    path = save(tmp_path / "transforms.json", nerfstudio(IMAGES, scale=scale))
    assert largest_difference(without_folder(read_transforms_json(path)), IMAGES) < 1e-6


def test_a_lens_for_all_frames(tmp_path: Path):
    path = save(tmp_path / "transforms.json", nerfstudio(ALIKE, shared_lens=True))
    assert largest_difference(without_folder(read_transforms_json(path)), ALIKE) < 1e-6


def test_instant_ngp_reads_back_to_the_same_poses(tmp_path: Path):
    path = save(tmp_path / "transforms.json", instant_ngp(ALIKE))
    assert largest_difference(without_folder(read_transforms_json(path)), ALIKE) < 1e-6


def test_a_file_without_applied_transform_is_not_turned(tmp_path: Path):
    written = nerfstudio(IMAGES)
    turned = np.array(written.pop("applied_transform"))
    cameras = read_transforms_json(save(tmp_path / "transforms.json", written))
    for (_, found), (_, camera) in zip(cameras, IMAGES, strict=True):
        np.testing.assert_allclose(found.position, turned[:, :3] @ camera.position, atol=1e-9)
        assert np.abs(found.position - camera.position).max() > 0.1


def test_angles_stand_in_for_focal_lengths(tmp_path: Path):
    angles = {"camera_angle_x": 2 * math.atan(50 / 80), "fl_x": ..., "fl_y": ..., "cx": ...}
    ((_, square),) = read_transforms_json(save(tmp_path / "t.json", content(**angles)))
    np.testing.assert_allclose(square.K, [[80, 0, 50], [0, 80, 31], [0, 0, 1]], atol=1e-9)
    angles["camera_angle_y"] = 2 * math.atan(30 / 90)
    ((_, camera),) = read_transforms_json(save(tmp_path / "t.json", content(**angles)))
    assert camera.K[0, 0] == pytest.approx(80)
    assert camera.K[1, 1] == pytest.approx(90)


def test_pixels_that_are_not_square_are_kept(tmp_path: Path):
    ((_, camera),) = read_transforms_json(save(tmp_path / "t.json", content(fl_y=40)))
    assert (camera.K[0, 0], camera.K[1, 1]) == (80, 40)


def test_a_frame_goes_before_the_file(tmp_path: Path):
    changed = framed(fl_x=10, fl_y=11, cx=5, cy=6, w=20, h=12)
    (_, first), (_, second) = read_transforms_json(save(tmp_path / "t.json", changed))
    assert first.K[0, 0] == 80
    np.testing.assert_array_equal(second.K, [[10, 0, 5], [0, 11, 6], [0, 0, 1]])
    assert (second.width, second.height) == (20, 12)


def test_sizes_are_taken_from_the_pictures(tmp_path: Path):
    write_png(tmp_path / "train" / "r_0.png", np.zeros((30, 50, 3), np.uint8))
    frame = {**FRAME, "file_path": "./train/r_0"}
    blender = {"camera_angle_x": 0.7, "frames": [frame]}
    ((name, camera),) = read_transforms_json(save(tmp_path / "transforms.json", blender))
    assert name == "train/r_0"
    assert (camera.width, camera.height) == (50, 30)
    assert camera.K[0, 0] == pytest.approx(25 / math.tan(0.35))


@pytest.mark.parametrize("prefix", [b"\xef\xbb\xbf", b"", b" \r\n\t"])
def test_windows_files(tmp_path: Path, prefix: bytes):
    path = tmp_path / "transforms.json"
    text = json.dumps(content(), indent=1).replace("\n", "\r\n")
    path.write_bytes(prefix + text.encode())
    assert [name for name, _ in read_cameras(path)] == ["a.png"]


MIRRORED = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]
STRETCHED = [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]]
SHEARED = [[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
PROJECTIVE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0.1, 1]]
NAN = float("nan")


@pytest.mark.parametrize(
    ("changed", "place", "message"),
    [
        (framed(transform_matrix=...), "frame 1, transform_matrix", "required"),
        (framed(file_path=...), "frame 1, file_path", "required"),
        (framed(transform_matrix=[[NAN] * 4] * 4), "frame 1, transform_matrix, 0, 0", "finite"),
        (framed(transform_matrix=[[1, 2, 3]] * 4), "frame 1, transform_matrix, 0", "at least 4"),
        (framed(transform_matrix=STRETCHED), "frame 1", "not rigid.*orthonormal"),
        (framed(transform_matrix=SHEARED), "frame 1", "not rigid.*orthonormal"),
        (framed(transform_matrix=MIRRORED), "frame 1", "not rigid.*determinant"),
        (framed(transform_matrix=PROJECTIVE), "frame 1", "not rigid.*last row"),
        (framed(transform_matrix=[[1e300] * 4] * 4), "frame 1", "not rigid"),
        (framed(file_path="images/a.png"), "frame 1", "is there twice"),
        (framed(file_path="../a.png"), "frame 1", "image name"),
        (framed(file_path="C:\\a.png"), "frame 1", "image name"),
        (framed(file_path="/a.png"), "frame 1", "image name"),
        (framed(fl_x=-1), "frame 1", "fx -1"),
        (framed(w=0), "frame 1", "size 0 x 60"),
        (framed(w=10.5), "frame 1", "size 10.5"),
        (framed(w="10"), "frame 1, w", "number"),
        (framed(k1=0.1), "frame 1", "distortion: k1 0.1.*image_undistorter"),
        (framed(distortion_params=[0, 0, 0.2]), "frame 1", "distortion_params"),
        (content(p2=-1e-3), "frame 0", "distortion: p2 -0.001"),
        (content(k4=1.0), "frame 0", "distortion: k4"),
        (content(is_fisheye=True), "frame 0", "is_fisheye"),
        (content(camera_model="OPENCV_FISHEYE"), "frame 0", "camera_model OPENCV_FISHEYE"),
        (content(camera_model="EQUIRECTANGULAR"), "frame 0", "camera_model EQUIRECT"),
        (content(fl_x=..., fl_y=...), "frame 0", "no focal length"),
        (content(w=...), "frame 0", "no w and h, and no picture 'images/a.png'"),
        (content(fl_x=..., fl_y=..., camera_angle_x=0), "camera_angle_x", "greater than 0"),
        (content(fl_x=..., fl_y=..., camera_angle_x=4.0), "camera_angle_x", "less than 3.14"),
        (content(frames=...), "frames", "required"),
        (content(frames=[]), None, "no image"),
        (content(frames={}), "frames", "array|list"),
        (content(applied_transform=MIRRORED), "applied_transform", "not rigid"),
        (content(applied_transform=MIRRORED[:2]), "applied_transform", "at least 3"),
        (content(applied_scale=0), None, "applied_scale is 0"),
    ],
)
def test_bad_files(tmp_path: Path, changed: dict[str, Any], place: str | None, message: str):
    path = save(tmp_path / "transforms.json", changed)
    with pytest.raises(CameraFormatError, match=message) as caught:
        read_transforms_json(path)
    assert caught.value.path == str(path)
    assert caught.value.place == place
    assert caught.value.accepted


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (b"{", "Invalid JSON"),
        (b'{"frames": [}', "Invalid JSON.*line 1"),
        (b'{"frames":' + b"[" * 100_000, "Invalid JSON"),
        ('{"frames": []}'.encode("utf-16"), "Invalid JSON|array|list"),
        (b"", "Invalid JSON"),
    ],
)
def test_files_that_are_no_json(tmp_path: Path, raw: bytes, message: str):
    path = tmp_path / "transforms.json"
    path.write_bytes(raw)
    with pytest.raises(CameraFormatError, match=message):
        read_cameras(path)


def test_a_missing_file(tmp_path: Path):
    with pytest.raises(CameraFormatError, match="no such file"):
        read_transforms_json(tmp_path / "transforms.json")


def test_a_distorted_file_is_told_apart_and_an_undistorted_copy_taken(tmp_path: Path):
    save(tmp_path / "transforms.json", content(k1=0.1))
    with pytest.raises(DistortedCameraError, match=r"undistorted/ or dense/ beside it"):
        find_cameras(tmp_path)
    write_colmap_text(tmp_path / "undistorted" / "sparse", IMAGES)
    source = find_cameras(tmp_path)
    assert source.folder == tmp_path / "undistorted"
    assert largest_difference(source.cameras, IMAGES) < 1e-12
    assert source.notes == (
        "transforms.json has distortion: cameras and pictures are taken from undistorted",
    )


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_damaged_files_are_read_or_refused(data: st.DataObject):
    whole = bytearray(json.dumps(framed(camera_model="PINHOLE", k1=0.0)).encode())
    places = st.integers(0, len(whole) - 1)
    for at, byte in data.draw(st.lists(st.tuples(places, st.integers(0, 255)), max_size=4)):
        whole[at] = byte
    start, stop = sorted((data.draw(places), data.draw(places)))
    kept = data.draw(st.sampled_from([whole, whole[:stop], whole[:start] + whole[stop:]]))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "transforms.json")
        path.write_bytes(kept)
        try:
            cameras = read_transforms_json(path)
        except GVRError as error:
            assert str(path) in str(error)
            return
    assert 1 <= len(cameras) <= 2
    assert all(np.isfinite(camera.world_to_camera).all() for _, camera in cameras)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.01, 100))
def test_any_cameras_come_back(seed: int, scale: float):
    images = some_cameras(seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        path = save(Path(folder, "transforms.json"), nerfstudio(images, scale=scale))
        found = without_folder(read_transforms_json(path))
    assert largest_difference(found, images) < 1e-6
    # The helper's matrices are what OpenGL says: the camera looks along its own -z.
    for _, camera in images:
        np.testing.assert_allclose(-opengl(camera)[:3, 2], camera.forward, atol=1e-9)
