from __future__ import annotations

import hashlib
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

from datasets import gallery
from datasets.base import SceneData
from datasets.gallery import ABSENT, GalleryDataset, compose, make_scene
from datasets.images import read_image
from datasets.making import visible
from datasets.photographs import PHOTOGRAPHS, read_photograph
from gvr_core.errors import ConfigError
from gvr_core.gaussians import SH_C0
from gvr_core.rendering.base import get_renderer


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("gallery")


@pytest.fixture(scope="module")
def scene(root: Path) -> SceneData:
    return GalleryDataset(root).load("gallery_0")


def file_hashes(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_the_same_seed_gives_the_same_bytes(scene: SceneData, root: Path, tmp_path: Path) -> None:
    made = file_hashes(root / "gallery_0")
    recipe = re.search(r'"recipe": "(\w+)"', (root / "gallery_0/scene.json").read_text())[1]
    make_scene(tmp_path / "again", "gallery_0", 0, recipe)
    assert file_hashes(tmp_path / "again") == made
    assert len(made) > 50


def test_a_scene_is_as_large_as_promised(scene: SceneData) -> None:
    assert 60_000 <= len(scene.scene.gaussians) <= 120_000
    assert len(scene.scene.views) == 24 and len(scene.truth.test_views) == 4
    for view in (*scene.scene.views, *scene.truth.test_views):
        assert (view.camera.width, view.camera.height) == (480, 360)
        assert read_image(view.image).shape == (360, 480, 3)


def test_test_views_are_taken_from_other_places(scene: SceneData) -> None:
    known = np.array([view.camera.position for view in scene.scene.views])
    for view in scene.truth.test_views:
        assert np.linalg.norm(known - view.camera.position, axis=1).min() > 0.2


def test_labels_agree_with_masks_in_the_test_views(scene: SceneData) -> None:
    means, labels = scene.scene.gaussians.means, scene.truth.labels
    for view in scene.truth.test_views:
        for index, target in enumerate(scene.truth.objects):
            mask = scene.truth.mask(view, target)
            pixels, _ = view.camera.project(means[labels == index])
            x, y = np.floor(pixels).astype(int).T
            inside = (x >= 0) & (x < 480) & (y >= 0) & (y < 360)
            # hidden sides project into the object's outline too, unless something covers it
            if mask.sum() > 500:
                assert mask[y[inside], x[inside]].mean() > 0.6


def test_masks_do_not_overlap(scene: SceneData) -> None:
    for view in scene.truth.test_views:
        stack = np.stack([scene.truth.mask(view, t) for t in scene.truth.objects])
        assert stack.sum(axis=0).max() == 1
        assert stack.any(axis=0).mean() > 0.1


def test_a_made_scene_is_not_made_again(
    scene: SceneData, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gallery, "make_scene", lambda *_: pytest.fail("made again"))
    assert GalleryDataset(root).load("gallery_0").digests == scene.digests


def test_another_version_makes_it_again(
    scene: SceneData, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []
    monkeypatch.setattr(gallery, "make_scene", lambda *args: calls.append(args))
    monkeypatch.setattr(gallery, "VERSION", gallery.VERSION + 1)
    GalleryDataset(root).load("gallery_0")
    assert [args[1:3] for args in calls] == [("gallery_0", 0)]


def test_an_unknown_scene_is_refused(root: Path) -> None:
    with pytest.raises(ConfigError, match=r"gallery_9.*accepted: gallery_0, gallery_5"):
        GalleryDataset(root, (0, 5)).load("gallery_9")


@pytest.fixture(scope="module")
def composed() -> list[gallery.GalleryScene]:
    return [compose(seed) for seed in range(4)]


def test_two_neighbouring_seeds_show_every_photograph_once(
    composed: list[gallery.GalleryScene],
) -> None:
    names = sorted(photo.name for photo in PHOTOGRAPHS)
    for first, second in (composed[:2], composed[2:]):
        assert sorted(first.objects + second.objects) == names


def test_every_scene_asks_twice_for_each_object_and_once_in_vain(
    composed: list[gallery.GalleryScene],
) -> None:
    for made in composed:
        targets = [query.target for query in made.queries if not query.absent]
        assert sorted(targets) == sorted(2 * list(made.objects))
        assert [query.text in ABSENT for query in made.queries if query.absent] == [True]
        assert 4 <= len(made.objects) <= 6


def test_things_stand_on_the_table_without_touching(composed: list[gallery.GalleryScene]) -> None:
    for made in composed:
        clouds = [made.gaussians.means[made.labels == i] for i in range(len(made.objects))]
        for i, cloud in enumerate(clouds):
            assert 0 <= cloud[:, 2].min() < 0.02
            assert np.abs(cloud[:, 0]).max() < 1.5 and cloud[:, 1].max() < 0.85
            for other in clouds[:i]:
                near, _ = cKDTree(cloud[:, :2]).query(other[:, :2])
                assert near.min() > 0.02


def test_most_of_each_thing_is_seen_in_most_views(composed: list[gallery.GalleryScene]) -> None:
    renderer, made = get_renderer("numba"), composed[0]
    shares = []
    for name in ("view_000", "view_003", "view_010", "view_013", "view_017", "view_023"):
        camera = made.cameras[name]
        seen = visible(renderer, made.gaussians, made.labels, len(made.objects), camera)
        for index in range(len(made.objects)):
            alone = made.labels == index
            rendering = renderer.render(made.gaussians.subset(alone), camera)
            whole = rendering.alpha > 0.5
            shares.append((seen[index] & whole).sum() / whole.sum())
    assert np.mean(np.array(shares) > 0.9) >= 0.75


def test_the_front_of_a_box_is_the_photograph(composed: list[gallery.GalleryScene]) -> None:
    made = composed[0]
    own = made.labels == made.objects.index("cat")
    heights, colours = made.gaussians.means[own, 2], 0.5 + SH_C0 * made.gaussians.sh[own, 0]
    # the front comes first: row by row, each as high as its first Gaussian
    columns = int(np.flatnonzero(np.abs(np.diff(heights)) > 1e-4)[0]) + 1
    rows = int(np.flatnonzero(np.diff(heights[::columns]) > 0)[0]) + 1
    front = colours[: rows * columns].reshape(rows, columns, 3)
    picture = read_photograph(next(p for p in PHOTOGRAPHS if p.name == "cat"))
    expected = np.asarray(Image.fromarray(picture).resize((columns, rows))) / 255
    assert min(rows, columns) >= 60
    assert np.corrcoef(front.ravel(), expected.ravel())[0, 1] > 0.98
    assert np.corrcoef(front[:, ::-1].ravel(), expected.ravel())[0, 1] < 0.9


@pytest.mark.parametrize("photo", PHOTOGRAPHS, ids=lambda photo: photo.name)
def test_each_photograph_can_be_read(photo) -> None:
    picture = read_photograph(photo)
    left, top, right, bottom = photo.crop
    assert picture.shape == (bottom - top, right - left, 3) and picture.dtype == np.uint8
    # a crop beyond the picture would be padded with black
    assert picture[-1].max() > 0 and picture[:, -1].max() > 0
    assert len(photo.wordings) >= 2 and photo.licence
