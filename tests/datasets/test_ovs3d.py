from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mask_trees import (
    SCENE,
    assert_same_camera,
    assert_same_truth,
    edit_mask,
    exported,
    hidden_in_first_test_view,
    stretch_pixels,
)

from datasets import export_ovs3d as writer
from datasets.base import SceneData
from datasets.export_ovs3d import export_ovs3d
from datasets.leakage import without_test_views
from datasets.mask_folders import Notes
from datasets.ovs3d import Ovs3dDataset, read_classes
from gvr_core.errors import ConfigError, DatasetError
from gvr_core.rendering.base import get_renderer
from gvr_core.scene import Query


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[SceneData, Path]:
    return exported(export_ovs3d, tmp_path_factory.mktemp("ovs3d"))


@pytest.fixture
def folder(made: tuple[SceneData, Path], tmp_path: Path) -> Path:
    """The scene's folder, to be changed."""
    return Path(shutil.copytree(made[1], tmp_path / "root")) / SCENE


def load(folder: Path) -> SceneData:
    return Ovs3dDataset(folder.parent).load(SCENE)


def rename_images(folder: Path, names: dict[str, str]) -> None:
    """Give pictures other stems, on disk and in the COLMAP model."""
    path = folder / "sparse/0/images.txt"
    text = path.read_text()
    for old, new in names.items():
        text = text.replace(f" {old}.jpg", f" {new}.jpg")
        (folder / f"images/{old}.jpg").rename(folder / f"images/{new}.jpg")
    path.write_text(text)


def test_what_is_exported_is_read(made: tuple[SceneData, Path]) -> None:
    given, root = made
    dataset = Ovs3dDataset(root)
    assert dataset.scenes() == (SCENE,)
    data = dataset.load(SCENE)
    assert (data.scene.dataset, data.scene.name) == ("ovs3d", SCENE)
    assert [view.name for view in data.scene.views] == ["v00", "v01", "v02", "v03", "v04"]
    assert [view.name for view in data.truth.test_views] == ["v01", "v04"]
    assert data.truth.objects == ("a blue box", "a red box")
    assert data.queries == (
        Query(id="a-blue-box", text="a blue box", target="a blue box"),
        Query(id="a-red-box", text="a red box", target="a red box"),
    )
    assert_same_truth(given, data, "v01", "v01")
    assert_same_truth(given, data, "v04", "v04")
    assert data.truth.mask(data.truth.test_views[0], "a red box").sum() > 50
    found = {view.name: view for view in data.scene.views}
    for view in (*given.scene.views, *given.truth.test_views):
        assert_same_camera(view.camera, found[view.name].camera)
    np.testing.assert_array_equal(data.scene.gaussians.means, given.scene.gaussians.means)
    assert data.truth.labels is None and data.scene.up is None and data.notes == ()
    assert data.protocols[:2] == ("ovs3d.binary/1", "ovs3d.exclusive/1")


def test_the_test_views_can_be_kept_from_the_methods(made: tuple[SceneData, Path]) -> None:
    data = without_test_views(Ovs3dDataset(made[1]).load(SCENE))
    assert [view.name for view in data.scene.views] == ["v00", "v02", "v03"]
    assert [view.name for view in data.truth.test_views] == ["v01", "v04"]


def test_every_class_is_labelled_in_every_folder(tmp_path: Path) -> None:
    given = hidden_in_first_test_view(tmp_path / "native", "red box")
    export_ovs3d(given, tmp_path / "root", get_renderer("numba"))
    masks = tmp_path / "root" / SCENE / "segmentations"
    names = sorted(path.relative_to(masks).as_posix() for path in masks.rglob("*.png"))
    assert names == [
        "01/a blue box.png",
        "01/a red box.png",
        "04/a blue box.png",
        "04/a red box.png",
    ]
    data = Ovs3dDataset(tmp_path / "root").load(SCENE)
    first = data.truth.test_views[0]
    assert data.truth.is_labelled(first, "a red box")
    assert not data.truth.mask(first, "a red box").any()
    assert data.notes == ()


def test_a_folder_may_have_the_name_of_its_picture(folder: Path) -> None:
    before = load(folder)
    (folder / "segmentations/01").rename(folder / "segmentations/v01")
    after = load(folder)
    assert after.digests == before.digests and after.notes == ()


def test_a_number_that_is_name_and_index_is_taken(folder: Path) -> None:
    rename_images(folder, {f"v0{i}": f"0{i}" for i in range(5)})
    data = load(folder)
    assert [view.name for view in data.truth.test_views] == ["01", "04"]
    assert data.notes == ()


def test_a_name_that_no_index_reaches_is_taken_and_noted(folder: Path) -> None:
    rename_images(folder, {"v04": "w12"})
    rename_images(folder, {"w12": "12"})  # sorts first
    (folder / "segmentations/01").rename(folder / "segmentations/v01")
    (folder / "segmentations/04").rename(folder / "segmentations/12")
    data = load(folder)
    assert [view.name for view in data.truth.test_views] == ["12", "v01"]
    assert data.notes == (
        "folders that are the name of a picture, and as a number beyond all: 1 (12)",
    )


def test_foreground_is_brighter_than_127_and_where_255_differs_is_noted(folder: Path) -> None:
    def change(grey: np.ndarray) -> np.ndarray:
        grey[:] = 0
        grey[0, :4] = (127, 128, 254, 255)
        return grey

    edit_mask(folder / "segmentations/01/a red box.png", change)
    data = load(folder)
    mask = data.truth.mask(data.truth.test_views[0], "a red box")
    assert np.argwhere(mask).tolist() == [[0, 1], [0, 2], [0, 3]]
    assert data.notes == (
        "masks that the published evaluator would read otherwise: 1 (01/a red box.png)",
    )


def test_a_test_view_is_as_large_as_its_masks(folder: Path) -> None:
    for name in ("a red box", "a blue box"):
        path = folder / f"segmentations/04/{name}.png"
        edit_mask(path, lambda grey: grey.repeat(4, axis=0).repeat(4, axis=1))
    data = load(folder)
    camera = data.truth.test_views[1].camera
    assert (camera.width, camera.height) == (384, 288)
    assert data.truth.mask(data.truth.test_views[1], "a red box").shape == (288, 384)
    known = next(view for view in data.scene.views if view.name == "v04")
    assert (known.camera.width, known.camera.height) == (96, 72)
    np.testing.assert_allclose(camera.K[:2], known.camera.K[:2] * 4)
    assert data.notes == ("test views scored at their masks' size: 1 (04: 384 x 288 for 96 x 72)",)


def test_pixels_need_not_be_square(folder: Path) -> None:
    fx = load(folder).scene.views[0].camera.K[0, 0]
    stretch_pixels(folder, 0.75)
    data = load(folder)
    for view in (*data.scene.views, *data.truth.test_views):
        assert view.camera.K[0, 0] == fx and view.camera.K[1, 1] == 0.75 * fx


@pytest.mark.parametrize(
    "content, classes, notes",
    [
        (b"wood\nbanana", ("banana", "wood"), ()),
        (b"wood\nbanana\n", ("banana", "wood"), ()),
        ("Pikachu\nétui\nape\n".encode(), ("Pikachu", "ape", "étui"), ()),
        (
            b"\xef\xbb\xbfwood\nape\n",
            ("ape", "wood"),
            ("byte order marks in classes.txt, dropped: 1 (line 1)",),
        ),
        (
            b"wood\r\nape\r\n",
            ("ape", "wood"),
            ("Windows' line ends in classes.txt, dropped: 2 (line 1, line 2)",),
        ),
        (
            b"\nwood\n\nape\n\n",
            ("ape", "wood"),
            ("blank lines in classes.txt, dropped: 3 (line 1, line 3, line 5)",),
        ),
        (
            b" wood \nape\t\n",
            ("ape", "wood"),
            ("outer spaces in classes.txt, dropped: 2 (line 1, line 2)",),
        ),
    ],
)
def test_classes_are_stripped_sorted_and_repairs_counted(
    tmp_path: Path, content: bytes, classes: tuple[str, ...], notes: tuple[str, ...]
) -> None:
    path = tmp_path / "classes.txt"
    path.write_bytes(content)
    found = Notes()
    assert read_classes(path, found) == classes
    assert found.lines() == notes


def test_scenes_come_in_the_published_order(folder: Path) -> None:
    for name in ("lawn", "sofa", "blue_sofa", "bed"):
        shutil.copytree(folder, folder.parent / name)
    (folder.parent / "notes").mkdir()
    dataset = Ovs3dDataset(folder.parent)
    assert dataset.scenes() == ("bed", "sofa", "lawn", "blue_sofa", SCENE)
    assert dataset.load("blue_sofa").scene.name == "blue_sofa"
    with pytest.raises(ConfigError, match="unknown scene of ovs3d 'bench'"):
        dataset.load("bench")


def test_each_digest_follows_its_own_part(folder: Path) -> None:
    before = load(folder).digests
    assert set(before) == {"gaussians", "views", "queries", "truth"}

    def changed() -> set[str]:
        after = load(folder).digests
        return {part for part in before if after[part] != before[part]}

    assert changed() == set()
    edit_mask(folder / "segmentations/01/a red box.png", lambda grey: 255 - grey)
    assert changed() == {"truth"}
    shutil.copy(folder / "images/v02.jpg", folder / "images/v00.jpg")
    assert changed() == {"truth", "views"}
    for place in ("01", "04"):
        masks = folder / "segmentations" / place
        (masks / "a red box.png").rename(masks / "a cow.png")
    (folder / "segmentations/classes.txt").write_text("a blue box\na cow\n")
    assert changed() == {"truth", "views", "queries"}


def test_what_has_no_place_in_the_layout_is_not_exported(
    made: tuple[SceneData, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = made[0]
    renderer = get_renderer("numba")
    numbered = replace(
        given, scene=replace(given.scene, views=(replace(given.scene.views[0], name="07"),))
    )
    with pytest.raises(DatasetError, match="'07' would be read as a number"):
        export_ovs3d(numbered, tmp_path, renderer)
    with pytest.raises(DatasetError, match="0 test views, 2 objects"):
        export_ovs3d(replace(given, truth=replace(given.truth, test_views=())), tmp_path, renderer)
    with pytest.raises(DatasetError, match="there is something already"):
        export_ovs3d(given, made[1], renderer)

    def full(*_: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(writer, "write_png", full)
    with pytest.raises(OSError, match="no space"):
        export_ovs3d(given, tmp_path, renderer)
    assert list(tmp_path.iterdir()) == []
