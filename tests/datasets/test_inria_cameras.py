"""``cameras.json``, and the one door to every format of cameras."""

from __future__ import annotations

import copy
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_sets import largest_difference, some_cameras
from hypothesis import given, settings
from hypothesis import strategies as st

from datasets.cameras_file import read_cameras
from datasets.colmap import read_colmap_model, write_colmap_text
from datasets.inria_cameras import read_inria_cameras, write_inria_cameras
from gvr_core.errors import CameraFormatError, GVRError

ENTRY: dict[str, Any] = {
    "id": 0,
    "img_name": "frame_1",
    "width": 100,
    "height": 60,
    # Looks along +x from (1, 2, 3): the columns are the camera's axes in the world.
    "position": [1, 2, 3.0],
    "rotation": [[0, 0, 1], [-1, 0, 0], [0, -1, 0]],
    "fx": 80.0,
    "fy": 81,
}


def save(path: Path, *entries: dict[str, Any]) -> Path:
    path.write_text(json.dumps(entries))
    return path


def test_one_camera(tmp_path: Path):
    ((name, camera),) = read_inria_cameras(save(tmp_path / "c.json", ENTRY))
    assert name == "frame_1"
    np.testing.assert_array_equal(camera.K, [[80, 0, 50], [0, 81, 30], [0, 0, 1]])
    np.testing.assert_allclose(camera.position, [1, 2, 3])
    np.testing.assert_allclose(camera.forward, [1, 0, 0])
    np.testing.assert_allclose(camera.to_camera([11, 2, 3]), [0, 0, 10], atol=1e-12)


def test_real_files_agree_with_the_colmap_model_of_the_same_photographs(shared: Path):
    plush = shared / "data" / "plush"
    inria = read_cameras(plush / "cameras.json")
    colmap = [(Path(name).stem, camera) for name, camera in read_cameras(plush)]
    assert len(inria) == 97
    assert largest_difference(inria, colmap) < 1e-6


def test_round_trip(tmp_path: Path):
    images = some_cameras(centred=True)
    path = tmp_path / "c.json"
    write_inria_cameras(path, images)
    once = read_inria_cameras(path)
    assert largest_difference(once, images) < 1e-12
    assert list(tmp_path.iterdir()) == [path]
    assert [entry["id"] for entry in json.loads(path.read_text())] == list(range(6))


def test_what_the_format_cannot_say_is_not_written(tmp_path: Path):
    with pytest.raises(CameraFormatError, match=r"principal point.*the middle of the picture"):
        write_inria_cameras(tmp_path / "c.json", some_cameras(centred=False))
    with pytest.raises(CameraFormatError, match="image name"):
        write_inria_cameras(tmp_path / "c.json", [("../a", some_cameras(centred=True)[0][1])])
    assert list(tmp_path.iterdir()) == []


def changed(**changes: Any) -> dict[str, Any]:
    return {k: v for k, v in {**copy.deepcopy(ENTRY), **changes}.items() if v is not ...}


@pytest.mark.parametrize(
    ("entry", "place", "message"),
    [
        (changed(fx=...), "camera 1, fx", "required"),
        (changed(rotation=...), "camera 1, rotation", "required"),
        (changed(img_name=7), "camera 1, img_name", "string"),
        (changed(width="100"), "camera 1, width", "integer"),
        (changed(width=0), "camera 1, width", "greater than or equal to 1"),
        (changed(height=10**30), "camera 1, height", "less than or equal to 65535"),
        (changed(fy=True), "camera 1, fy", "number"),
        (changed(fx=float("nan")), "camera 1, fx", "finite"),
        (changed(position=[0, 0]), "camera 1, position", "at least 3"),
        (changed(position=[0, 0, float("inf")]), "camera 1, position, 2", "finite"),
        (changed(rotation=[[1, 0, 0], [0, 1, 0]]), "camera 1, rotation", "at least 3"),
        (changed(fx=-80.0), "camera 1", "fx -80"),
        (changed(fx=0), "camera 1", "fx 0"),
        (changed(rotation=[[2, 0, 0], [0, 2, 0], [0, 0, 2]]), "camera 1", "orthonormal"),
        (changed(rotation=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]), "camera 1", "orthonormal"),
        (changed(rotation=[[1e300] * 3] * 3, position=[1e300] * 3), "camera 1", "not finite"),
        (changed(img_name="../a"), "camera 1", "image name"),
        (changed(img_name="/a"), "camera 1", "image name"),
        (changed(img_name=""), "camera 1", "image name"),
        (changed(), "camera 1", "is there twice"),
        ([], "camera 1", "dictionary|object"),
    ],
)
def test_bad_entries(tmp_path: Path, entry: Any, place: str, message: str):
    path = save(tmp_path / "c.json", ENTRY, entry)
    with pytest.raises(CameraFormatError, match=message) as caught:
        read_inria_cameras(path)
    assert caught.value.path == str(path)
    assert caught.value.place == place
    assert caught.value.accepted


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "Invalid JSON"),
        (b"[{]", "Invalid JSON.*line 1 column"),
        (b"[" * 100_000, "Invalid JSON"),
        (b"{}", "array|list"),
        (b"null", "array|list"),
        (b"[]", "no image"),
        (b"\xff\xfe", "Invalid JSON"),
    ],
)
def test_files_that_are_no_list_of_cameras(tmp_path: Path, content: bytes, message: str):
    path = tmp_path / "c.json"
    path.write_bytes(content)
    with pytest.raises(CameraFormatError, match=message):
        read_inria_cameras(path)


def test_one_door_for_all_formats(tmp_path: Path):
    images = some_cameras(centred=True)
    write_inria_cameras(tmp_path / "cameras.json", images)
    write_colmap_text(tmp_path / "scene" / "sparse" / "0", images)
    for path in ("cameras.json", "scene", "scene/sparse/0"):
        assert largest_difference(read_cameras(tmp_path / path), images) < 1e-12
    model = read_colmap_model(tmp_path / "scene" / "sparse" / "0")
    assert [name for name, _ in read_cameras(tmp_path / "scene")] == list(model.cameras)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("", "no cameras in this folder"),
        ("nowhere", "no such file or folder"),
        ("nowhere.json", "no such file"),
        ("cameras.txt", "no camera file of a known kind"),
        ("x" * 300, "no such file or folder"),
        ("x" * 300 + ".json", "no such file"),
    ],
)
def test_paths_without_cameras(tmp_path: Path, name: str, message: str):
    (tmp_path / "cameras.txt").touch()
    with pytest.raises(CameraFormatError, match=rf"{message}.*accepted: a.*cameras\.json"):
        read_cameras(tmp_path / name)


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_damaged_files_are_read_or_refused(data: st.DataObject):
    content = bytearray(json.dumps([ENTRY, changed(img_name="frame_2")]).encode())
    places = st.integers(0, len(content) - 1)
    for at, byte in data.draw(st.lists(st.tuples(places, st.integers(0, 255)), max_size=4)):
        content[at] = byte
    start, stop = sorted((data.draw(places), data.draw(places)))
    kept = data.draw(st.sampled_from([content, content[:stop], content[:start] + content[stop:]]))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "cameras.json")
        path.write_bytes(kept)
        try:
            cameras = read_cameras(path)
        except GVRError as error:
            assert str(path) in str(error)
            return
    assert 1 <= len(cameras) <= 2
    assert all(np.isfinite(camera.world_to_camera).all() for _, camera in cameras)
