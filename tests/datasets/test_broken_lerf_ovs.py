"""Trees of LERF-OVS in which something is missing or does not fit."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from lerf_ovs_tree import FRAMES, SCENE, edit, exported, info, label_path
from PIL import Image

from datasets.base import SceneData
from datasets.lerf_ovs import LerfOvsDataset
from gvr_core.errors import CameraFormatError, ConfigError, DatasetError, InputError


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(tmp_path_factory.mktemp("lerf_ovs"))[1]


@pytest.fixture
def root(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "tree"))


def load(root: Path) -> SceneData:
    return LerfOvsDataset(root).load(SCENE)


def refused(root: Path, *words: str, kind: type[InputError] = DatasetError) -> None:
    """Reading ends in an error that holds the words."""
    with pytest.raises(kind) as caught:
        load(root)
    for word in words:
        assert word in str(caught.value)


def test_a_missing_label_file_is_named(root: Path) -> None:
    label_path(root).unlink()
    refused(root, "frame_00002.jpg: a labelled picture without its labels", "frame_00002.json")


def test_labels_without_frames_are_refused(root: Path) -> None:
    shutil.rmtree(root / "label" / SCENE)
    (root / "label" / SCENE).mkdir()
    with pytest.raises(DatasetError, match="no scene has labels"):
        LerfOvsDataset(root).scenes()
    (root / SCENE).rename(root / "ramen")
    (root / "label" / SCENE).rename(root / "label" / "ramen")
    with pytest.raises(DatasetError, match="label/ramen: no labels"):
        LerfOvsDataset(root).load("ramen")


def test_frames_without_any_object_are_refused(root: Path) -> None:
    for frame in FRAMES:
        edit(root, lambda content: content.update(objects=[]), frame)
    refused(root, f"label/{SCENE}: no frame has an object")


def test_a_root_without_labels_is_refused(root: Path) -> None:
    with pytest.raises(DatasetError, match=r"no folder label/ here.*ramen, figurines"):
        LerfOvsDataset(root / "label").scenes()
    with pytest.raises(DatasetError, match="nowhere"):
        LerfOvsDataset(root / "nowhere").load(SCENE)


def test_an_unknown_scene_is_refused(root: Path) -> None:
    with pytest.raises(ConfigError, match=r"'attic'.*two-boxes"):
        LerfOvsDataset(root).load("attic")


def test_labels_without_their_scene_are_refused(root: Path) -> None:
    shutil.rmtree(root / SCENE)
    assert LerfOvsDataset(root).scenes() == (SCENE,)
    refused(root, f"{SCENE}: no such folder")


def test_a_scene_without_a_splat_is_refused(root: Path) -> None:
    shutil.rmtree(root / SCENE / "point_cloud")
    refused(root, str(root / SCENE), "point_cloud/iteration_N/point_cloud.ply")


def test_a_scene_without_cameras_is_refused(root: Path) -> None:
    shutil.rmtree(root / SCENE / "sparse")
    refused(root, str(root / SCENE), kind=CameraFormatError)


def without_image(root: Path, name: str) -> None:
    """Take an image out of the COLMAP model."""
    path = root / SCENE / "sparse" / "0" / "images.txt"
    lines = path.read_text().splitlines(keepends=True)
    at = next(i for i, line in enumerate(lines) if name in line)
    path.write_text("".join(lines[:at] + lines[at + 2 :]))


def test_a_frame_that_is_not_registered_is_refused(root: Path) -> None:
    without_image(root, FRAMES[0])
    refused(root, "frame_00002.json", "'frame_00002.jpg', which has no camera")
    (root / SCENE / "images" / f"{FRAMES[0]}.jpg").unlink()
    refused(root, "frame_00002.json", "'frame_00002' is not among the 4 registered images")


def test_a_frame_is_found_by_name_where_an_index_would_miss(root: Path) -> None:
    without_image(root, "frame_00003")
    data = load(root)
    assert [view.name for view in data.truth.test_views] == list(FRAMES)
    assert data.notes == (
        "frames that an index into the sorted images would miss, found by name: 1 (frame_00005)",
    )


def test_an_image_that_is_labelled_twice_is_refused(root: Path) -> None:
    path = edit(root, info("name", "frame_2.jpg"))
    shutil.copyfile(label_path(root, FRAMES[1]), path.with_name("frame_00002.json.keep"))
    path.rename(path.with_name("frame_2.json"))
    path.with_suffix(".jpg").unlink()
    assert load(root).truth.test_views[1].name == FRAMES[0]
    shutil.copyfile(path.with_name("frame_2.json"), path)
    edit(root, info("name", "frame_00002.jpg"))
    refused(root, "frame_2.json", "'frame_00002.jpg' is labelled by frame_00002.json already")


def test_labels_of_another_shape_than_the_camera_are_refused(root: Path) -> None:
    path = edit(root, info("height", 96))
    Image.new("RGB", (96, 96)).save(path.with_suffix(".jpg"))
    refused(root, "frame_00002.json", "96 x 96 pixels", "96 x 72, as the camera has")


def test_a_labelled_picture_that_is_none_is_refused(root: Path) -> None:
    label_path(root).with_suffix(".jpg").write_bytes(b"no picture")
    refused(root, "frame_00002.jpg: the picture cannot be decoded")
