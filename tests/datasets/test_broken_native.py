"""Scenes on disk in which something is missing, does not fit, or is hostile."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from native_scene import written

from datasets.images import write_png
from datasets.native import read_recipe, read_scene
from gvr_core.errors import CameraFormatError, DatasetError, SplatFormatError


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("native") / "two-boxes", recipe="abc")


@pytest.fixture
def folder(original: Path, tmp_path: Path) -> Path:
    copy = tmp_path / "two-boxes"
    shutil.copytree(original, copy)
    return copy


@pytest.mark.parametrize(
    "missing",
    [
        "scene.json",
        "queries.json",
        "labels.npy",
        "point_cloud/iteration_30000/point_cloud.ply",
        "sparse/0/cameras.txt",
        "sparse/0/images.txt",
        "images/v02.png",
        "images/v04.png",
    ],
)
def test_a_missing_file_is_named(folder: Path, missing: str) -> None:
    (folder / missing).unlink()
    with pytest.raises(DatasetError) as caught:
        read_scene(folder)
    assert missing in str(caught.value)


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="nothing-here"):
        read_scene(tmp_path / "nothing-here")
    assert read_recipe(tmp_path / "nothing-here") is None


def edit(path: Path, **changes: Any) -> None:
    content = json.loads(path.read_text())
    path.write_text(json.dumps({**content, **changes}))


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"test_views": ["v01", "v99"]}, "test_views[1]: unknown view 'v99' (accepted: v00, v01"),
        ({"test_views": ["v00", "v01", "v02", "v03", "v04"]}, "every view is a test view"),
        ({"test_views": ["v01"]}, "masks of an unknown view"),
        ({"objects": ["red box"]}, "blue box"),
        ({"objects": ["red box", "red box"]}, "'red box' is there twice"),
        ({"objects": ["red box", "Red Box"]}, "differ only in case"),
        ({"objects": ["red box", "../../etc"]}, "objects[1]: the object name '../../etc'"),
        ({"objects": ["red box", 3]}, "objects[1]"),
        ({"colour": "red"}, "colour: an unknown key"),
        ({"version": 2}, "version"),
        ({"format": "other"}, "format"),
        ({"up": [0, 0, 0]}, "up: no direction"),
        ({"up": [0, 0, float("nan")]}, "up[2]"),
        ({"up": [0, 1]}, "up"),
        ({"name": "con"}, "name: the scene name 'con'"),
    ],
)
def test_a_scene_file_that_does_not_fit_is_refused(folder: Path, changes: Any, words: str) -> None:
    edit(folder / "scene.json", **changes)
    with pytest.raises(DatasetError) as caught:
        read_scene(folder)
    assert words in str(caught.value)
    assert str(folder) in str(caught.value)


@pytest.mark.parametrize(
    "content, words",
    [
        ('[\n{"id": "a", "text": "b"},\n{"id" "c"}]', "line 3: not JSON"),
        ('{"id": "a", "text": "b"}', "dict at the top (accepted: a list of queries)"),
        ('["a"]', "[0]"),
        ('[{"id": "a", "text": "b"}, {"id": "a", "text": "c"}]', "[1].id: the query id 'a'"),
        ('[{"id": "a", "text": "b", "target": "cow"}]', "[0].target: query 'a' means 'cow'"),
        ('[{"id": "a", "text": "b", "target": "red box", "absent": true}]', "[0].absent"),
        ('[{"id": "a/b", "text": "b"}]', "[0].id"),
        ('[{"id": "a", "text": ""}]', "[0].text"),
        ('[{"id": "a", "text": "b", "colour": 1}]', "[0].colour: an unknown key"),
        ("[" * 100_000, "queries.json"),
        (b"\xff\xfe", "queries.json: cannot be read"),
    ],
)
def test_queries_that_do_not_fit_are_refused(
    folder: Path, content: str | bytes, words: str
) -> None:
    raw = content if isinstance(content, bytes) else content.encode()
    (folder / "queries.json").write_bytes(raw)
    with pytest.raises(DatasetError) as caught:
        read_scene(folder)
    assert words in str(caught.value) and "queries.json" in str(caught.value)


def with_value(n: int, value: int) -> np.ndarray:
    labels = np.full(n, -1, np.int16)
    labels[7] = value
    return labels


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda n: np.full(n - 1, -1, np.int16), "labels of shape"),
        (lambda n: np.full((n, 1), -1, np.int16), "labels of shape"),
        (lambda n: np.full(n, -1, np.int32), "dtype int32"),
        (lambda n: with_value(n, 2), "Gaussian 7: label 2 (accepted: -1 to 1)"),
        (lambda n: with_value(n, -2), "Gaussian 7: label -2"),
        (lambda n: np.array([{"a": 1}], dtype=object), "without pickle"),
    ],
)
def test_labels_that_do_not_fit_are_refused(folder: Path, make: Any, words: str) -> None:
    np.save(folder / "labels.npy", make(len(read_scene(folder).scene.gaussians)))
    with pytest.raises(DatasetError) as caught:
        read_scene(folder)
    assert words in str(caught.value) and "labels.npy" in str(caught.value)


def test_labels_that_claim_more_than_the_file_holds_are_refused(folder: Path) -> None:
    path = folder / "labels.npy"
    raw = path.read_bytes()
    start = raw.index(b"(", raw.index(b"shape"))
    claimed = b"(99999999999999,), }"
    path.write_bytes(raw[:start] + claimed + raw[start + len(claimed) :])
    with pytest.raises(DatasetError, match="no array"):
        read_scene(folder)


def test_pictures_and_masks_of_another_size_are_refused(folder: Path) -> None:
    write_png(folder / "images/v03.png", np.zeros((10, 20, 3), np.uint8))
    with pytest.raises(DatasetError, match=r"v03.png: .*20 x 10 pixels .*96 x 72"):
        read_scene(folder)


def test_a_mask_of_another_size_is_refused(folder: Path) -> None:
    write_png(folder / "test_masks/v01/red box.png", np.zeros((10, 20), np.bool_))
    with pytest.raises(DatasetError, match=r"red box.png: .*20 x 10"):
        read_scene(folder)


def test_a_mask_of_an_unknown_object_is_refused(folder: Path) -> None:
    (folder / "test_masks/v01/red box.png").rename(folder / "test_masks/v01/cow.png")
    with pytest.raises(DatasetError, match=r"cow.png: a mask of an unknown object"):
        read_scene(folder)


def test_a_picture_that_is_none_is_refused(folder: Path) -> None:
    (folder / "images/v03.png").write_bytes(b"not a picture")
    with pytest.raises(DatasetError, match=r"v03.png: the picture cannot be decoded"):
        read_scene(folder)


def test_a_damaged_splat_is_refused(folder: Path) -> None:
    path = folder / "point_cloud/iteration_30000/point_cloud.ply"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(SplatFormatError, match=r"point_cloud\.ply"):
        read_scene(folder)


@pytest.mark.parametrize(
    "image", ["../outside.png", "/etc/passwd", "deep/inside.png", "nul.png", "v 0.png.png"]
)
def test_a_camera_with_an_image_name_that_leads_elsewhere_is_refused(
    folder: Path, image: str
) -> None:
    path = folder / "sparse/0/images.txt"
    path.write_text(path.read_text().replace("v00.png", image))
    with pytest.raises((DatasetError, CameraFormatError), match=r"accepted"):
        read_scene(folder)
