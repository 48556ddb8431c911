from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from native_scene import QUERIES, parts, written
from small_scene import OBJECTS

from datasets import native_writer
from datasets.images import read_image, read_mask, write_png
from datasets.native import Picture, read_recipe, read_scene, write_scene
from gvr_core.errors import DatasetError
from gvr_core.scene import Query


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("native") / "two-boxes", recipe="abc")


@pytest.fixture
def folder(original: Path, tmp_path: Path) -> Path:
    copy = tmp_path / "two-boxes"
    shutil.copytree(original, copy)
    return copy


def test_what_is_written_is_read(original: Path) -> None:
    given = parts()
    data = read_scene(original, "mine", "renamed")
    assert (data.scene.dataset, data.scene.name) == ("mine", "renamed")
    assert (read_scene(original).scene.dataset, read_scene(original).scene.name) == (
        "test",
        "two-boxes",
    )
    np.testing.assert_allclose(data.scene.gaussians.means, given["gaussians"].means, atol=1e-6)
    np.testing.assert_allclose(data.scene.gaussians.sh, given["gaussians"].sh, atol=1e-6)
    np.testing.assert_array_equal(data.truth.labels, given["labels"])
    np.testing.assert_allclose(data.scene.up_direction, (0, 0, 1))
    assert data.queries == QUERIES and data.truth.objects == OBJECTS
    assert [view.name for view in data.scene.views] == ["v00", "v02", "v03"]
    assert [view.name for view in data.truth.test_views] == ["v01", "v04"]
    by_name = {picture.name: picture for picture in given["pictures"]}
    for view in (*data.scene.views, *data.truth.test_views):
        np.testing.assert_array_equal(read_image(view.image), by_name[view.name].rgb)
        camera = by_name[view.name].camera
        np.testing.assert_allclose(view.camera.K, camera.K)
        np.testing.assert_allclose(view.camera.world_to_camera, camera.world_to_camera, atol=1e-12)
    for view in data.truth.test_views:
        for target in OBJECTS:
            expected = by_name[view.name].masks[target]
            np.testing.assert_array_equal(data.truth.mask(view, target), expected)
    assert data.truth.flags("blue box").sum() == 14**3
    assert read_recipe(original) == "abc"


def test_masks_are_where_the_objects_are(original: Path) -> None:
    data = read_scene(original)
    for view in data.truth.test_views:
        rgb = read_image(view.image).astype(int)
        red, blue = data.truth.mask(view, "red box"), data.truth.mask(view, "blue box")
        assert red.sum() > 50 and blue.sum() > 50 and not (red & blue).any()
        assert (rgb[red, 0] > rgb[red, 2]).mean() > 0.99
        assert (rgb[blue, 2] > rgb[blue, 0]).mean() > 0.99


def test_an_object_that_a_view_does_not_show_has_no_mask(tmp_path: Path) -> None:
    given = parts()
    for picture in given["pictures"]:
        if picture.masks is not None:
            picture.masks["red box"][:] = False
    data = read_scene(written(tmp_path / "s", pictures=given["pictures"]))
    assert not data.truth.mask(data.truth.test_views[0], "red box").any()
    assert not (tmp_path / "s/test_masks/v01/red box.png").exists()


def test_each_digest_follows_its_own_part(folder: Path) -> None:
    before = read_scene(folder).digests
    assert set(before) == {"gaussians", "views", "queries", "truth"}
    assert read_scene(folder).digests == before

    def changed() -> set[str]:
        after = read_scene(folder).digests
        return {part for part in before if after[part] != before[part]}

    (folder / "queries.json").write_text('[{"id": "q", "text": "a cube"}]')
    assert changed() == {"queries"}
    labels = np.load(folder / "labels.npy")
    labels[0] = -1
    np.save(folder / "labels.npy", labels)
    assert changed() == {"queries", "truth"}
    picture = read_image(folder / "images/v00.png")
    write_png(folder / "images/v00.png", 255 - picture)
    assert changed() == {"queries", "truth", "views"}
    write_png(folder / "images/v01.png", 255 - picture)  # a test view: nothing depends on it
    assert changed() == {"queries", "truth", "views"}


def test_a_changed_mask_changes_the_truth_alone(folder: Path) -> None:
    before = read_scene(folder).digests
    path = folder / "test_masks/v01/red box.png"
    write_png(path, ~read_mask(path))
    after = read_scene(folder).digests
    assert {part for part in before if after[part] != before[part]} == {"truth"}


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"objects": ("red box", "a/b")}, "'a/b' cannot be a file name"),
        ({"objects": ("red box", "..")}, "'..' cannot be a file name"),
        ({"objects": ("red box", "COM1")}, "'COM1' cannot be a file name"),
        ({"objects": ("red box", "a" * 65)}, "cannot be a file name"),
        ({"objects": ("red box", "box ")}, "'box ' cannot be a file name"),
        ({"objects": ("red box", "café")}, "cannot be a file name"),
        ({"objects": ("red box",), "queries": ()}, "accepted: -1 to 0"),
        ({"labels": np.zeros(3, np.int16)}, "labels of shape (3,)"),
        ({"queries": (Query(id="q", text="t", target="cow"),)}, "no object of the scene"),
        ({"queries": (QUERIES[0], QUERIES[0])}, "'red-1' is there twice"),
        ({"name": "../up"}, "scene name"),
    ],
)
def test_what_does_not_fit_is_not_written(tmp_path: Path, changes: Any, words: str) -> None:
    with pytest.raises(DatasetError) as caught:
        written(tmp_path / "s", **changes)
    assert words in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda p: Picture("a/b", p.camera, p.rgb), "view name 'a/b'"),
        (lambda p: Picture(p.name, p.camera, p.rgb[1:]), "the picture has shape (71, 96)"),
        (
            lambda p: Picture(p.name, p.camera, p.rgb, {"cow": np.zeros((72, 96), np.bool_)}),
            "a mask of 'cow'",
        ),
        (
            lambda p: Picture(p.name, p.camera, p.rgb, {"red box": np.zeros((9, 9), np.bool_)}),
            "mask of 'red box' has shape (9, 9)",
        ),
        (lambda p: Picture("V01", p.camera, p.rgb), "differ only in case"),
    ],
)
def test_pictures_that_do_not_fit_are_not_written(tmp_path: Path, change: Any, words: str) -> None:
    pictures = parts()["pictures"]
    pictures[0] = change(pictures[0])
    with pytest.raises(DatasetError) as caught:
        written(tmp_path / "s", pictures=pictures)
    assert words in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_scene_is_replaced_only_when_asked(folder: Path) -> None:
    with pytest.raises(DatasetError, match="there is something already"):
        write_scene(folder, **parts())
    assert read_scene(folder).truth.objects == OBJECTS
    written(folder, replace=True, queries=QUERIES[:1])
    assert read_scene(folder).queries == QUERIES[:1]
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


def test_a_writer_that_fails_leaves_the_old_scene(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = read_scene(folder).digests

    def full(*_: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(native_writer, "write_png", full)
    with pytest.raises(OSError, match="no space"):
        written(folder, replace=True)
    assert read_scene(folder).digests == before
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]
