"""Broken COLMAP models of every kind: each gives an error that names file, place and remedy."""

from __future__ import annotations

import struct
import tempfile
import tracemalloc
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from camera_sets import some_cameras
from hypothesis import given, settings
from hypothesis import strategies as st
from small_colmap import CAMERAS, FILES, IMAGES, POINTS, write_files, write_small_for_binary

from datasets.colmap import read_colmap_model, write_colmap_text
from datasets.colmap_records import CAMERA_MODELS
from gvr_core.errors import CameraFormatError, GVRError


@pytest.fixture
def small(tmp_path: Path) -> Path:
    return write_files(tmp_path, cameras=CAMERAS, images=IMAGES, points3D=POINTS)


@pytest.mark.parametrize(
    ("file", "text", "place", "message"),
    [
        ("cameras", "1 PINHOLE 640\n", "line 1", "3 fields"),
        ("cameras", "\n1 PINHOLE 640 480 500 501 320\n", "line 2", "3 parameters"),
        ("cameras", "1 PINHOLE 640 480 500 501 320 240 0\n", "line 1", "5 parameters"),
        ("cameras", "1 OPENCV 9 9 1 1 1 1 .1 0 0 0\n", "line 1", "model is OPENCV.*undistort"),
        ("cameras", "1 SIMPLE_RADIAL 9 9 1 1 1 -.1\n", "line 1", "k1 -0.1.*PINHOLE or"),
        ("cameras", "one PINHOLE 640 480 500 501 320 240\n", "line 1", "'one' is not a whole"),
        ("cameras", "1 PINHOLE 640 480 500 x 320 240\n", "line 1", "'x' is not a number"),
        ("cameras", "1 PINHOLE 640 480 nan 501 320 240\n", "line 1", "fx nan"),
        ("cameras", "1 PINHOLE 640 480 500 -1 320 240\n", "line 1", "fy -1"),
        ("cameras", "1 PINHOLE 0 480 500 501 320 240\n", "line 1", "0 x 480"),
        ("cameras", "1 PINHOLE 9999999999 480 500 501 320 240\n", "line 1", "65535 pixels"),
        ("cameras", CAMERAS + "7 PINHOLE 9 9 1 1 1 1\n", "line 5", "camera 7 is there twice"),
        ("images", "1 1 0 0 0 0 0 0 1\n\n", "line 1", "9 fields"),
        ("images", "1 1 0 0 0 0 0 0 3 a.jpg\n\n", "line 1", "unknown camera 3.*1, 7"),
        ("images", "1 0 0 0 0 0 0 0 1 a.jpg\n\n", "line 1", "length 0"),
        ("images", "1 1 0 inf 0 0 0 0 1 a.jpg\n\n", "line 1", "length inf"),
        ("images", "1 1 0 0 0 0 nan 0 1 a.jpg\n\n", "line 1", "translation"),
        ("images", "1 1 0 0 0 0 0 0 one a.jpg\n\n", "line 1", "'one'"),
        ("images", IMAGES + "3 1 0 0 0 0 0 0 1 b/second.jpg\n\n", "line 6", "is there twice"),
        ("images", "1 1 0 0 0 0 0 0 1 a.jpg\n2 1 0 0 0 0 0 0 1 b.jpg\n", "line 2", "10 fields"),
        ("images", "# nothing\n", None, "no image"),
        ("images", "", None, "no image"),
        ("points3D", "1 0 0 0 255 255\n", "line 1", "6 fields"),
        ("points3D", "1 0 0 0 9 9 9 0.5 1\n", "line 1", "9 fields"),
        ("points3D", "1 0 inf 0 9 9 9 0.5\n", "line 1", "finite"),
        ("points3D", "1 0 0 0 9 256 9 0.5\n", "line 1", "256"),
    ],
)
def test_broken_lines(small: Path, file: str, text: str, place: str | None, message: str):
    write_files(small, **{file: text})
    with pytest.raises(CameraFormatError, match=message) as caught:
        read_colmap_model(small)
    assert caught.value.path == str(small / f"{file}.txt")
    assert caught.value.place == place
    assert caught.value.accepted


@pytest.mark.parametrize(
    "name",
    ["/etc/passwd", "../a.jpg", "a/../../b.jpg", "..", "a\\b.jpg", "C:/a.jpg", "a\x07.jpg", "."],
)
def test_names_that_leave_the_folder(small: Path, tmp_path: Path, name: str):
    write_files(small, images=f"1 1 0 0 0 0 0 0 1 {name}\n\n")
    with pytest.raises(CameraFormatError, match=r"relative path.*without '\.\.'"):
        read_colmap_model(small)
    with pytest.raises(CameraFormatError, match="relative path"):
        write_colmap_text(tmp_path / "new", [(name, some_cameras()[0][1])])


def test_missing_files(tmp_path: Path):
    with pytest.raises(CameraFormatError, match=r"no such folder.*cameras\.txt and images\.txt"):
        read_colmap_model(tmp_path / "nowhere")
    write_files(tmp_path, cameras=CAMERAS)
    with pytest.raises(CameraFormatError, match=r"no COLMAP model.*cameras\.bin and images\.bin"):
        read_colmap_model(tmp_path)


def test_text_that_is_none(small: Path):
    (small / "images.txt").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(CameraFormatError, match="no text"):
        read_colmap_model(small)


@pytest.mark.parametrize("file", ["cameras", "images", "points3D"])
def test_binary_counts_that_promise_too_much(small: Path, file: str):
    pycolmap.Reconstruction(str(write_small_for_binary(small))).write_binary(str(small))
    path = small / f"{file}.bin"
    path.write_bytes(struct.pack("<Q", 2**60) + path.read_bytes()[8:])
    tracemalloc.start()
    try:
        with pytest.raises(CameraFormatError, match=f"promises {2**60}"):
            read_colmap_model(small)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 2**20


@pytest.mark.parametrize("file", ["cameras", "images", "points3D"])
def test_binary_files_that_are_too_short_or_too_long(small: Path, file: str):
    pycolmap.Reconstruction(str(write_small_for_binary(small))).write_binary(str(small))
    path = small / f"{file}.bin"
    content = path.read_bytes()
    for length in range(len(content)):
        path.write_bytes(content[:length])
        with pytest.raises(CameraFormatError, match=r"ends early|promises"):
            read_colmap_model(small)
    path.write_bytes(content + b"\0")
    with pytest.raises(CameraFormatError, match="1 bytes follow"):
        read_colmap_model(small)


@pytest.mark.parametrize(
    ("model", "message"), [(4, "OPENCV"), (99, "number 99"), (-1, "number -1")]
)
def test_binary_cameras_with_distortion(small: Path, model: int, message: str):
    pycolmap.Reconstruction(str(write_small_for_binary(small))).write_binary(str(small))
    camera = struct.pack("<QIiQQ8d", 1, 1, model, 64, 48, 50, 50, 32, 24, 0, 0, 0, 1e-9)
    (small / "cameras.bin").write_bytes(camera)
    with pytest.raises(CameraFormatError, match=f"model is {message} .*undistort"):
        read_colmap_model(small)


def test_camera_models_are_numbered_as_in_colmap():
    judged = {int(v): k for k, v in pycolmap.CameraModelId.__members__.items() if int(v) >= 0}
    known = {i: name for i, name in judged.items() if i < len(CAMERA_MODELS)}
    assert dict(enumerate(CAMERA_MODELS)) == known


def test_models_that_are_not_written(tmp_path: Path):
    images = some_cameras()
    new = tmp_path / "new"
    with pytest.raises(CameraFormatError, match="holds a space"):
        write_colmap_text(new, [("a b.jpg", images[0][1])])
    with pytest.raises(CameraFormatError, match="is there twice"):
        write_colmap_text(new, [images[0], images[0]])
    with pytest.raises(CameraFormatError, match="no image"):
        write_colmap_text(new, [])
    for points, colours in (
        (np.zeros((2, 3)), np.zeros((1, 3))),
        (np.zeros((2, 2)), np.zeros((2, 2))),
        (np.full((1, 3), np.nan), np.zeros((1, 3))),
        (np.zeros((1, 3)), np.full((1, 3), 300)),
    ):
        with pytest.raises(CameraFormatError, match="do not fit together"):
            write_colmap_text(new, images, points, colours)
    assert not new.exists()
    new.mkdir()
    (new / "images.bin").touch()
    with pytest.raises(CameraFormatError, match=r"holds images\.bin"):
        write_colmap_text(new, images)


def _seed_models() -> dict[str, bytes]:
    """The files of one small model in both forms."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_colmap_text(folder, some_cameras(3), [[1, 2, 3], [4, 5, 6]], [[1, 2, 3], [4, 5, 6]])
        pycolmap.Reconstruction(str(folder)).write_binary(str(folder))
        paths = [folder / f"{file}{end}" for file in FILES for end in (".txt", ".bin")]
        return {path.name: path.read_bytes() for path in paths}


SEED_MODELS = _seed_models()


@settings(max_examples=400, deadline=None)
@given(st.sampled_from(sorted(SEED_MODELS)), st.data())
def test_damaged_models_are_read_or_refused(damaged: str, data: st.DataObject):
    content = bytearray(SEED_MODELS[damaged])
    places = st.integers(0, len(content) - 1)
    for at, byte in data.draw(st.lists(st.tuples(places, st.integers(0, 255)), max_size=5)):
        content[at] = byte
    start, stop = sorted((data.draw(places), data.draw(places)))
    pieces = {
        "keep": content,
        "cut": content[:stop],
        "drop": content[:start] + content[stop:],
        "double": content[:stop] + content[start:],
    }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for other, whole in SEED_MODELS.items():
            if other[-4:] == damaged[-4:]:
                (folder / other).write_bytes(whole)
        (folder / damaged).write_bytes(pieces[data.draw(st.sampled_from(sorted(pieces)))])
        try:
            model = read_colmap_model(folder)
        except GVRError as error:
            assert name in str(error)
            return
    assert list(model.cameras) == sorted(model.cameras)
    assert not any(image.startswith("/") or ".." in image.split("/") for image in model.cameras)
    assert np.isfinite(model.points3D).all()
