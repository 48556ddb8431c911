"""What is put right in trees of LERF-OVS: counted, said, and without effect on the rest."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lerf_ovs_tree import FRAMES, SCENE, edit, exported, first, label_path
from PIL import Image

from datasets.base import SceneData
from datasets.lerf_ovs import LerfOvsDataset

SQUARE = [[1, 1], [9, 1], [9, 9], [1, 9]]


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(tmp_path_factory.mktemp("lerf_ovs"))[1]


@pytest.fixture
def root(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "tree"))


def load(root: Path) -> SceneData:
    return LerfOvsDataset(root).load(SCENE)


def noted(data: SceneData, words: str) -> None:
    """One note, and it holds the words."""
    assert len(data.notes) == 1 and words in data.notes[0], data.notes


def same(data: SceneData, original: Path) -> None:
    """Masks and boxes are those of the sound tree."""
    sound = load(original)
    assert set(data.truth.masks) == set(sound.truth.masks)
    for view in sound.truth.test_views:
        for target in sound.truth.objects:
            assert np.array_equal(data.truth.mask(view, target), sound.truth.mask(view, target))
    assert data.truth.boxes == sound.truth.boxes


def test_a_byte_order_mark_is_passed_over(root: Path, original: Path) -> None:
    path = label_path(root)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    data = load(root)
    noted(data, "begin with a byte order mark, passed over: 1 (frame_00002)")
    same(data, original)


def test_windows_line_ends_are_read(root: Path, original: Path) -> None:
    for frame in FRAMES:
        path = label_path(root, frame)
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    data = load(root)
    noted(data, "Windows line ends, read as others: 2 (frame_00002, frame_00005)")
    same(data, original)


def test_an_object_that_is_there_twice_counts_once(root: Path, original: Path) -> None:
    edit(root, lambda content: content["objects"].append(content["objects"][0]))
    data = load(root)
    noted(data, "there twice, counted once: 1 (frame_00002, objects[2])")
    same(data, original)


def test_a_category_that_is_there_twice_is_a_union(root: Path, original: Path) -> None:
    item = {"category": "a red box", "segmentation": SQUARE, "bbox": [1, 1, 9, 9]}
    edit(root, lambda content: content["objects"].append(item))
    data, sound = load(root), load(original)
    view = data.truth.test_views[0]
    expected = sound.truth.mask(view, "a red box").copy()
    expected[1:10, 1:10] = True
    assert np.array_equal(data.truth.mask(view, "a red box"), expected)
    boxes = sound.truth.boxes[view.name, "a red box"]
    assert data.truth.boxes[view.name, "a red box"] == (*boxes, (1, 1, 9, 9))
    assert data.notes == () and len(data.queries) == 2


def test_corners_outside_are_clipped(root: Path) -> None:
    def change(content: dict[str, Any]) -> None:
        item = content["objects"][0]
        item.update(segmentation=[[-50, -50], [20, -50], [20, 20.5], [-50, 20]])
        item.update(bbox=[-50, -50, 20, 20])

    edit(root, change)
    data = load(root)
    noted(data, "reach beyond the picture, clipped: 1 (frame_00002, objects[0])")
    mask = data.truth.mask(data.truth.test_views[0], data.truth.objects[0])
    assert mask[:21, :21].all() and mask.sum() == 21 * 21


def test_flat_polygons_are_read(root: Path, original: Path) -> None:
    def change(content: dict[str, Any]) -> None:
        for item in content["objects"]:
            item["segmentation"] = [[x for corner in item["segmentation"] for x in corner]]

    edit(root, change)
    data = load(root)
    noted(data, "in COCO's form, taken for corners: 2 (frame_00002, objects[0]")
    same(data, original)


def test_boxes_that_do_not_fit_are_kept(root: Path) -> None:
    edit(root, first("bbox", [0, 0, 3, 3]))
    data = load(root)
    noted(data, "do not hold their polygon, kept as stated: 1 (frame_00002, objects[0])")
    assert data.truth.boxes[FRAMES[0], data.truth.objects[0]] == ((0, 0, 3, 3),)


def test_boxes_with_exchanged_corners_are_put_in_order(root: Path, original: Path) -> None:
    def change(content: dict[str, Any]) -> None:
        x0, y0, x1, y1 = content["objects"][0]["bbox"]
        content["objects"][0]["bbox"] = [x1, y0, x0, y1]

    edit(root, change)
    data = load(root)
    noted(data, "corners are exchanged, put in order: 1 (frame_00002, objects[0])")
    same(data, original)


def test_a_missing_box_is_that_of_the_polygon(root: Path) -> None:
    def change(content: dict[str, Any]) -> None:
        content["objects"][0].update(segmentation=SQUARE)
        del content["objects"][0]["bbox"]

    edit(root, change)
    data = load(root)
    noted(data, "without a box, their polygon's taken: 1")
    assert data.truth.boxes[FRAMES[0], data.truth.objects[0]] == ((1, 1, 9, 9),)


def test_a_polygon_without_area_is_its_outline(root: Path) -> None:
    edit(root, first("segmentation", [[5, 7], [9, 7], [5, 7]]))
    edit(root, first("bbox", [5, 7, 9, 7]))
    data = load(root)
    mask = data.truth.mask(data.truth.test_views[0], data.truth.objects[0])
    assert mask[7, 5:10].all() and mask.sum() == 5
    noted(data, "polygons that enclose nothing, drawn as lines: 1 (frame_00002, objects[0])")


def test_an_alpha_channel_is_not_looked_at(root: Path, original: Path) -> None:
    path = label_path(root).with_suffix(".png")
    Image.new("RGBA", (96, 72), (9, 9, 9, 0)).save(path)
    path.with_suffix(".jpg").unlink()
    data = load(root)
    noted(data, "with an alpha channel, which is not looked at: 1 (frame_00002.png)")
    same(data, original)


def test_a_missing_picture_is_said(root: Path, original: Path) -> None:
    label_path(root).with_suffix(".jpg").unlink()
    data = load(root)
    noted(data, "without their picture, size taken as stated: 1 (frame_00002)")
    assert data.truth.test_views[0].image == root / SCENE / "images" / "frame_00002.jpg"
    same(data, original)


def test_extra_folders_and_files_are_said(root: Path, original: Path) -> None:
    (root / "label" / SCENE / "gt").mkdir()
    (root / "label" / SCENE / "readme.txt").write_text("hello")
    (root / "label" / SCENE / "._frame_00002.json").write_bytes(b"\x00\x05")
    (root / "label" / "old").mkdir()
    (root / "output").mkdir()
    (root / "__MACOSX").mkdir()
    data = load(root)
    assert data.notes == (
        "folders among the labels, left out: 1 (gt)",
        "files that are neither labels nor pictures, left out: 1 (readme.txt)",
        "folders without labels, left out: 2 (output, label/old)",
    )
    same(data, original)


def test_a_frame_without_objects_is_said(root: Path) -> None:
    edit(root, lambda content: content.update(objects=[]))
    data = load(root)
    noted(data, "labelled frames without an object: 1 (frame_00002)")
    assert {view for view, _ in data.truth.masks} == {FRAMES[1]}
    assert not data.truth.is_labelled(data.truth.test_views[0], data.truth.objects[0])
