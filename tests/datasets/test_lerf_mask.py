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
from native_scene import parts, written
from PIL import Image

from datasets import exporting
from datasets.base import SceneData
from datasets.export_lerf_mask import export_lerf_mask
from datasets.lerf_mask import PROMPTS, LerfMaskDataset
from datasets.making import take_pictures
from datasets.native import read_scene
from gvr_core.errors import ConfigError, DatasetError
from gvr_core.rendering.base import get_renderer
from gvr_core.scene import Query


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[SceneData, Path]:
    return exported(export_lerf_mask, tmp_path_factory.mktemp("lerf_mask"))


@pytest.fixture
def folder(made: tuple[SceneData, Path], tmp_path: Path) -> Path:
    """The scene's folder, to be changed."""
    return Path(shutil.copytree(made[1], tmp_path / "root")) / SCENE


def load(folder: Path) -> SceneData:
    return LerfMaskDataset(folder.parent).load(SCENE)


def test_what_is_exported_is_read(made: tuple[SceneData, Path]) -> None:
    given, root = made
    dataset = LerfMaskDataset(root)
    assert dataset.scenes() == (SCENE,)
    data = dataset.load(SCENE)
    assert (data.scene.dataset, data.scene.name) == ("lerf_mask", SCENE)
    assert [view.name for view in data.scene.views] == ["v00", "v02", "v03"]
    assert [view.name for view in data.truth.test_views] == ["test_0", "test_1"]
    assert data.truth.objects == ("a blue box", "a red box")
    assert data.queries == (
        Query(id="a-blue-box", text="a blue box", target="a blue box"),
        Query(id="a-red-box", text="a red box", target="a red box"),
    )
    assert_same_truth(given, data, "v01", "test_0")
    assert_same_truth(given, data, "v04", "test_1")
    assert data.truth.mask(data.truth.test_views[0], "a red box").sum() > 50
    for before, after in zip(given.scene.views, data.scene.views, strict=True):
        assert_same_camera(before.camera, after.camera)
    np.testing.assert_array_equal(data.scene.gaussians.means, given.scene.gaussians.means)
    assert data.truth.labels is None and data.scene.up is None and data.notes == ()
    assert data.protocols[0] == "lerf_mask.gg/1" and "gvr.in_scene_2d/1" in data.protocols


def test_the_pictures_are_photographs_in_jpeg(made: tuple[SceneData, Path]) -> None:
    given, root = made
    path = LerfMaskDataset(root).load(SCENE).scene.views[0].image
    with Image.open(path) as picture, Image.open(given.scene.views[0].image) as original:
        assert picture.format == "JPEG"
        assert picture.size == original.size
        difference = np.asarray(picture, float) - np.asarray(original.convert("RGB"), float)
    assert np.abs(difference).mean() < 3
    names = {path.name for path in (root / SCENE / "images_train").iterdir()}
    assert names == {"v00.jpg", "v02.jpg", "v03.jpg"}


def test_an_index_may_be_missing(tmp_path: Path) -> None:
    given = hidden_in_first_test_view(tmp_path / "native", "red box", "blue box")
    export_lerf_mask(given, tmp_path / "root", get_renderer("numba"))
    masks = tmp_path / "root" / SCENE / "test_mask"
    assert [path.name for path in masks.iterdir()] == ["1"]
    data = LerfMaskDataset(tmp_path / "root").load(SCENE)
    assert [view.name for view in data.truth.test_views] == ["test_1"]
    assert "test_0" not in [view.name for view in data.scene.views]
    assert_same_truth(given, data, "v04", "test_1")
    (masks / "0").mkdir()
    data = LerfMaskDataset(tmp_path / "root").load(SCENE)
    assert data.notes == ("folders in test_mask/ without masks, left out: 1 (0)",)


def test_a_view_is_not_labelled_for_what_it_does_not_show(tmp_path: Path) -> None:
    given = hidden_in_first_test_view(tmp_path / "native", "red box")
    export_lerf_mask(given, tmp_path / "root", get_renderer("numba"))
    data = LerfMaskDataset(tmp_path / "root").load(SCENE)
    first, second = data.truth.test_views
    assert not data.truth.is_labelled(first, "a red box")
    assert data.truth.is_labelled(first, "a blue box")
    assert data.truth.is_labelled(second, "a red box")
    assert_same_truth(given, data, "v01", "test_0")


def test_more_than_ten_test_views_keep_their_order(tmp_path: Path) -> None:
    given = parts(13)
    cameras = {picture.name: picture.camera for picture in given["pictures"]}
    pictures = take_pictures(
        get_renderer("numba"),
        given["gaussians"],
        given["labels"],
        given["objects"],
        cameras,
        list(cameras)[1:],
    )
    original = read_scene(written(tmp_path / "native", pictures=pictures))
    export_lerf_mask(original, tmp_path / "root", get_renderer("numba"))
    data = LerfMaskDataset(tmp_path / "root").load(SCENE)
    assert [view.name for view in data.truth.test_views] == [f"test_{i:02d}" for i in range(12)]
    for i in range(12):
        assert_same_truth(original, data, f"v{i + 1:02d}", f"test_{i:02d}")


def test_foreground_is_brighter_than_128(folder: Path) -> None:
    def change(grey: np.ndarray) -> np.ndarray:
        grey[:] = 0
        grey[0, :3] = (127, 128, 129)
        return grey

    edit_mask(folder / "test_mask/0/a red box.png", change)
    data = load(folder)
    mask = data.truth.mask(data.truth.test_views[0], "a red box")
    assert np.argwhere(mask).tolist() == [[0, 2]]
    assert data.notes == ()


def test_a_view_is_as_large_as_its_masks(folder: Path) -> None:
    for name in ("a red box", "a blue box"):
        edit_mask(folder / f"test_mask/1/{name}.png", lambda grey: grey[::2, ::2])
    before = LerfMaskDataset(folder.parent).load(SCENE).truth.test_views
    assert (before[0].camera.width, before[0].camera.height) == (96, 72)
    camera = before[1].camera
    assert (camera.width, camera.height) == (48, 36)
    np.testing.assert_allclose(camera.K[:2] * 2, before[0].camera.K[:2])
    data = load(folder)
    assert data.truth.mask(data.truth.test_views[1], "a red box").shape == (36, 48)
    assert data.notes == ("test views scored at their masks' size: 1 (1: 48 x 36 for 96 x 72)",)


def test_pixels_need_not_be_square(folder: Path) -> None:
    fx = load(folder).scene.views[0].camera.K[0, 0]
    stretch_pixels(folder, 1.25)
    data = load(folder)
    for view in (*data.scene.views, *data.truth.test_views):
        assert view.camera.K[0, 0] == fx and view.camera.K[1, 1] == 1.25 * fx


def test_a_folder_may_have_the_name_of_its_picture(folder: Path) -> None:
    before = load(folder)
    (folder / "test_mask/0").rename(folder / "test_mask/test_0")
    after = load(folder)
    assert after.digests == before.digests and after.notes == ()


def test_without_a_list_the_names_tell_the_test_views(folder: Path) -> None:
    before = load(folder)
    shutil.rmtree(folder / "images_train")
    after = load(folder)
    assert after.digests == before.digests
    assert len(after.notes) == 1 and "images_train/ missing, images named test_*" in after.notes[0]


def test_scenes_come_in_the_published_order(folder: Path) -> None:
    for name in ("teatime", "ramen", "another"):
        shutil.copytree(folder, folder.parent / name)
    (folder.parent / "figurines").mkdir()  # listed: that it has no masks is to be said
    (folder.parent / "notes").mkdir()
    (folder.parent / ".cache").mkdir()
    dataset = LerfMaskDataset(folder.parent)
    assert dataset.scenes() == ("figurines", "ramen", "teatime", "another", SCENE)
    with pytest.raises(DatasetError, match=r"figurines.test_mask: missing folder"):
        dataset.load("figurines")
    with pytest.raises(ConfigError, match="unknown scene of lerf_mask 'notes'"):
        dataset.load("notes")
    assert LerfMaskDataset(folder.parent / "ramen").scenes() == ("ramen",)


def test_prompts_are_compared_with_the_published_ones(folder: Path) -> None:
    masks = folder / "test_mask"
    for path in masks.glob("*/a red box.png"):
        path.rename(path.with_name("pork belly.png"))
    scene = folder.rename(folder.parent / "ramen")
    notes = LerfMaskDataset(scene.parent).load("ramen").notes
    assert notes == (
        "of 6 published prompts without a mask: 5 (chopsticks, egg, glass of water and 2 more)",
        "prompts that the published scene does not have: 1 (a blue box)",
    )
    for path in scene.glob("test_mask/*/a blue box.png"):
        path.unlink()
    for prompt in PROMPTS["ramen"]:
        shutil.copy(scene / "test_mask/0/pork belly.png", scene / f"test_mask/1/{prompt}.png")
    assert LerfMaskDataset(scene.parent).load("ramen").notes == ()


def test_each_digest_follows_its_own_part(folder: Path) -> None:
    before = load(folder).digests
    assert set(before) == {"gaussians", "views", "queries", "truth"}

    def changed() -> set[str]:
        after = load(folder).digests
        return {part for part in before if after[part] != before[part]}

    assert changed() == set()
    edit_mask(folder / "test_mask/0/a red box.png", lambda grey: 255 - grey)
    assert changed() == {"truth"}
    shutil.copy(folder / "images/v02.jpg", folder / "images/v00.jpg")
    assert changed() == {"truth", "views"}
    shutil.copy(folder / "test_mask/0/a red box.png", folder / "test_mask/0/a cow.png")
    assert changed() == {"truth", "views", "queries"}


def test_splats_may_lie_elsewhere(folder: Path, tmp_path: Path) -> None:
    before = load(folder)
    (tmp_path / "splats").mkdir()
    trained = folder / "point_cloud/iteration_30000/point_cloud.ply"
    trained.rename(tmp_path / f"splats/{SCENE}.ply")
    data = LerfMaskDataset(folder.parent, tmp_path / "splats").load(SCENE)
    assert data.digests == before.digests


def test_nothing_is_exported_over_something(made: tuple[SceneData, Path]) -> None:
    given, root = made
    before = sorted(path for path in root.rglob("*"))
    with pytest.raises(DatasetError, match="there is something already"):
        export_lerf_mask(given, root, get_renderer("numba"))
    assert sorted(path for path in root.rglob("*")) == before


def test_an_export_that_fails_leaves_nothing(
    made: tuple[SceneData, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(exporting, "write_photograph", full)
    with pytest.raises(OSError, match="no space"):
        export_lerf_mask(made[0], tmp_path / "root", get_renderer("numba"))
    assert list((tmp_path / "root").iterdir()) == []


def test_what_has_no_place_in_the_layout_is_not_exported(
    made: tuple[SceneData, Path], tmp_path: Path
) -> None:
    given = made[0]
    truth = given.truth
    renderer = get_renderer("numba")
    seen = replace(given, scene=replace(given.scene, views=(*given.scene.views, *truth.test_views)))
    with pytest.raises(DatasetError, match="'v01' is a knowledge view as well"):
        export_lerf_mask(seen, tmp_path, renderer)
    taken = replace(
        given,
        scene=replace(given.scene, views=(replace(given.scene.views[0], name="test_1"),)),
    )
    with pytest.raises(DatasetError, match="'test_1' is there twice"):
        export_lerf_mask(taken, tmp_path, renderer)
    unseen = replace(given, truth=replace(truth, masks={}))
    with pytest.raises(DatasetError, match="no test view shows an object"):
        export_lerf_mask(unseen, tmp_path, renderer)
    assert list(tmp_path.iterdir()) == []


def test_a_prompt_is_the_first_text_that_can_be_a_file(
    made: tuple[SceneData, Path], tmp_path: Path
) -> None:
    given = made[0]
    queries = (
        Query(id="a", text="which/box?", target="red box"),
        Query(id="b", text="the box", target="red box"),
        Query(id="c", text="The Box", target="blue box"),
        Query(id="d", text="a cow", absent=True),
    )
    export_lerf_mask(replace(given, queries=queries), tmp_path, get_renderer("numba"))
    data = LerfMaskDataset(tmp_path).load(SCENE)
    assert data.truth.objects == ("blue box", "the box")


def test_a_view_without_a_picture_is_rendered(made: tuple[SceneData, Path], tmp_path: Path) -> None:
    given = made[0]
    bare = tuple(replace(view, image=None) for view in given.scene.views)
    bare_scene = replace(given, scene=replace(given.scene, views=bare))
    export_lerf_mask(bare_scene, tmp_path, get_renderer("numba"))
    name = f"{SCENE}/images/v02.jpg"
    assert (tmp_path / name).read_bytes() == (made[1] / name).read_bytes()
