"""Label files of LERF-OVS that are not as published: refused, with the place in the file."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from lerf_ovs_tree import SCENE, Change, edit, exported, first, info, label_path

from datasets.lerf_ovs import LerfOvsDataset
from gvr_core.errors import DatasetError


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(tmp_path_factory.mktemp("lerf_ovs"))[1]


@pytest.fixture
def root(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "tree"))


NAN = float("nan")


def refused(root: Path, path: Path, *words: str) -> None:
    """Reading ends in an error about the file that holds the words."""
    with pytest.raises(DatasetError) as caught:
        LerfOvsDataset(root).load(SCENE)
    for word in (str(path), *words):
        assert word in str(caught.value)


@pytest.mark.parametrize(
    "change, words",
    [
        (first("segmentation", []), ("objects[0].segmentation: no polygon", "[[x, y], [x, y]")),
        (first("segmentation", [[1, 1], [9, 9]]), ("segmentation: a polygon with 2 corners",)),
        (
            first("segmentation", [[1, 1], [9, 1], [NAN, 9]]),
            ("objects[0].segmentation[2]: the corner [nan, 9]", "two numbers"),
        ),
        (first("segmentation", [[1, 1], [9, 1], [9, float("inf")]]), ("segmentation[2]",)),
        (first("segmentation", [[1, 1], [9, 1], [9, 10**400]]), ("segmentation[2]",)),
        (first("segmentation", [[1, 1], [9, 1], ["9", 9]]), ("segmentation[2]: the corner ['9'",)),
        (first("segmentation", [[1, 1], [9, 1], [True, 9]]), ("segmentation[2]",)),
        (first("segmentation", [[1, 1], [9, 1], [9, 9, 9]]), ("segmentation[2]",)),
        (first("segmentation", [[1, 1], [9, 1], 9]), ("segmentation: not a list of corners",)),
        (first("segmentation", [1, 1, 9, 1, 9, 9]), ("segmentation: not a list of corners",)),
        (first("segmentation", [[1, 1, 9, 1, 9, None]]), ("segmentation[0], corner 2",)),
        (first("segmentation", [[1, 1, 9, 1]]), ("segmentation: a polygon with 1 corners",)),
        (first("segmentation", "SQUARE"), ("objects[0].segmentation: 'SQUARE'",)),
        (
            first("segmentation", [[200, 1], [209, 1], [209, 9]]),
            ("objects[0].segmentation: the polygon lies outside", "96 x 72"),
        ),
        (first("category", ""), ("objects[0].category: the text ''",)),
        (first("category", " \t"), ("objects[0].category",)),
        (first("category", "a\ncup"), ("objects[0].category",)),
        (first("category", "x" * 401), ("objects[0].category", "400")),
        (first("category", 7), ("objects[0].category: '7'",)),
        (first("bbox", [1, 1, 9]), ("objects[0].bbox: the box [1, 1, 9]", "[x1, y1, x2, y2]")),
        (first("bbox", [1, 1, 9, "9"]), ("objects[0].bbox",)),
        (first("bbox", [1, 1, 9, NAN]), ("objects[0].bbox",)),
        (first("bbox", "1 1 9 9"), ("objects[0].bbox",)),
        (lambda content: content["objects"][0].pop("category"), ("objects[0].category",)),
        (lambda content: content["objects"][0].pop("segmentation"), ("objects[0].segmentation",)),
        (lambda content: content.update(objects={}), ("objects",)),
        (lambda content: content.update(objects=[7]), ("objects[0]",)),
        (lambda content: content.pop("objects"), ("objects",)),
        (lambda content: content.pop("info"), ("info",)),
        (lambda content: content["info"].pop("width"), ("info.width",)),
        (info("height", "72"), ("info.height: '72'",)),
        (info("height", 0), ("info.height",)),
        (info("height", 72.5), ("info.height",)),
        (info("width", 10**9), ("info: a picture of 1000000000 x 72 pixels",)),
        (info("width", 95), ("info: the labels are of 95 x 72 pixels", "96 x 72, as frame_00002")),
        (info("name", "frame_00003.jpg"), ("info.name: the labels are of 'frame_00003.jpg'",)),
    ],
)
def test_labels_that_are_not_as_published_are_refused(
    root: Path, change: Change, words: tuple[str, ...]
) -> None:
    path = edit(root, change)
    refused(root, path, *words)


@pytest.mark.parametrize(
    "raw, words",
    [
        (b'{\n"info": {},\n"objects": [}', "line 3: not JSON"),
        (b"", "line 1: not JSON"),
        (b"[]", "'[]'"),
        (b"\xff\xfe{\x00}\x00", "cannot be read as JSON"),
        (b"[" * 100_000, "cannot be read as JSON"),
        (b'{"info": ' + b"9" * 5000 + b"}", "cannot be read as JSON"),
    ],
)
def test_files_that_are_no_json_are_refused(root: Path, raw: bytes, words: str) -> None:
    label_path(root).write_bytes(raw)
    refused(root, label_path(root), words)
