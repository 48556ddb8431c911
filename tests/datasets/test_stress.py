"""Each stress scene is what its name says, in numbers. Needs the shared splats."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from datasets.base import SceneData
from datasets.composing import Composition, compose
from datasets.composite import STRESS_LAYOUTS
from datasets.layout import read_layout
from datasets.making import visible
from datasets.registry import get_dataset
from gvr_core.cameras import Camera, birds_eye_camera, intrinsics, up_vector
from gvr_core.rendering.base import get_renderer
from gvr_core.scene import View

SCENES = (
    "absent",
    "ceiling",
    "floaters",
    "frontal",
    "hidden",
    "hundredfold",
    "stuff",
    "tilted",
    "twins",
    "wall_behind",
)
SMALL = (160, 120)
"""Pixels are counted in pictures of half the size."""

Load = Callable[[str], SceneData]


@pytest.fixture(scope="module")
def load(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Load]:
    """Each scene by name, made once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GVR_SPLATS", str(shared / "data" / "splats"))
        patch.setenv("GVR_DATA", str(tmp_path_factory.mktemp("data")))
        yield cache(get_dataset("stress", {}).load)


def composed(shared: Path, name: str, **changes: object) -> Composition:
    layout = read_layout(STRESS_LAYOUTS / f"{name}.toml").model_copy(update=changes)
    return compose(layout, {file: shared / "data" / "splats" / file for file in layout.splats()})


def cameras(data: SceneData) -> list[Camera]:
    return [view.camera for view in data.scene.views]


def masks(data: SceneData, views: list[Camera], target: str) -> NDArray[np.bool_]:
    """(n, 120, 160) where a thing is seen."""
    flags = data.truth.flags(target)
    assert flags is not None
    labels = np.where(flags, 0, -1).astype(np.int16)
    renderer, gaussians = get_renderer("numba"), data.scene.gaussians
    return np.stack([visible(renderer, gaussians, labels, 1, c.resized(*SMALL))[0] for c in views])


def shares(data: SceneData, views: list[Camera], target: str) -> NDArray[np.float64]:
    """(n,) parts of the pictures that a thing takes up."""
    found: NDArray[np.float64] = masks(data, views, target).mean(axis=(1, 2))
    return found


def main_object(data: SceneData) -> str:
    """The thing that a scene is about comes first."""
    return data.truth.objects[0]


def test_the_data_set_has_the_ten_scenes(shared: Path, load: Load) -> None:
    assert tuple(get_dataset("stress", {}).scenes()) == SCENES


@pytest.mark.parametrize("name", SCENES)
def test_what_all_scenes_have_in_common(load: Load, name: str) -> None:
    data = load(name)
    assert (data.scene.dataset, data.scene.name) == ("stress", name)
    assert data.scene.up is None
    assert len(data.scene.views) == 16 and len(data.truth.test_views) == 3
    every = [view.camera for view in (*data.scene.views, *data.truth.test_views)]
    assert {(camera.width, camera.height) for camera in every} == {(320, 240)}
    assert len(data.scene.gaussians) < 230_000
    absent = [query.text for query in data.queries if query.absent]
    assert len(set(absent)) == len(absent) == (8 if name == "absent" else 1)
    asked = [query.target for query in data.queries if not query.absent]
    assert 2 <= len(data.truth.objects) <= 3 and set(asked) == set(data.truth.objects)
    labels = data.truth.labels
    assert labels is not None
    things = data.scene.gaussians.means[labels >= 0]
    scale = 100 if name == "hundredfold" else 1
    for camera in every:
        assert np.linalg.norm(things - camera.position, axis=1).min() > 0.5 * scale
    large = shares(data, cameras(data), main_object(data)) > 0.015
    assert large.mean() >= (0.45 if name == "hidden" else 1)


def test_from_above_the_ceiling_hides_everything(load: Load) -> None:
    data = load("ceiling")
    flags = data.truth.flags("houseplant")
    middle = data.scene.gaussians.means[flags].mean(axis=0)
    views = [
        birds_eye_camera(middle, (0, 0, 1), height, intrinsics(55, *SMALL), *SMALL)
        for height in (4.0, 1.5)
    ]
    for target in data.truth.objects:
        above, below = shares(data, views, target)
        assert above == 0
        assert target != "houseplant" or below > 0.02
    assert max(camera.position[2] for camera in cameras(data)) < 2.1
    down = [np.degrees(np.arcsin(-camera.forward[2])) for camera in cameras(data)]
    assert 3 <= min(down) < 6 and 20 < max(down) <= 25


def test_the_wall_is_close_behind_the_guitar(load: Load) -> None:
    data = load("wall_behind")
    means, flags = data.scene.gaussians.means, data.truth.flags("guitar")
    assert flags is not None
    height = np.ptp(np.percentile(means[flags, 2], [1, 99]))
    wall = means[(data.truth.labels == -1) & (means[:, 2] > 0.01)]
    back = np.percentile(means[flags, 1], 99)
    gap = wall[:, 1].min() - back
    assert 0 < gap < 0.06 * height and means[flags, 1].max() < wall[:, 1].min()
    assert max(camera.position[1] for camera in cameras(data)) < wall[:, 1].min() - 0.1
    # a test of centres against the masks of single views takes the wall along
    centre_test = {
        target: np.mean([in_column(data, view, target) for view in data.truth.test_views])
        for target in data.truth.objects
    }
    assert centre_test["guitar"] < 0.95 and centre_test["cup of coffee"] < 0.5


def in_column(data: SceneData, view: View, target: str) -> float:
    """Of the Gaussians whose centres fall into a thing's mask, the share that belongs to it."""
    pixels, depth = view.camera.project(data.scene.gaussians.means)
    x, y = np.nan_to_num(np.floor(pixels), nan=-1).astype(int).T
    chosen = (x >= 0) & (x < view.camera.width) & (y >= 0) & (y < view.camera.height) & (depth > 0)
    chosen[chosen] = data.truth.mask(view, target)[y[chosen], x[chosen]]
    flags = data.truth.flags(target)
    assert flags is not None
    return float(flags[chosen].mean())


def test_both_twins_are_the_guitar(load: Load) -> None:
    data = load("twins")
    gaussians, flags = data.scene.gaussians, data.truth.flags("guitar")
    assert flags is not None
    first, second = np.split(np.flatnonzero(flags), 2)
    np.testing.assert_array_equal(gaussians.opacities[first], gaussians.opacities[second])
    np.testing.assert_allclose(gaussians.scales[first], gaussians.scales[second], rtol=1e-5)
    left, right = gaussians.means[first], gaussians.means[second]
    assert left[:, 0].max() < 0 < right[:, 0].min()
    width = np.ptp(np.percentile(left[:, 0], [1, 99]))
    assert (np.median(right[:, 0]) - np.median(left[:, 0])) > 3 * width
    for view in data.truth.test_views:
        mask = data.truth.mask(view, "guitar")
        for instance in (left, right):
            x, y = np.clip(view.camera.project(instance)[0], 0, (319, 239)).astype(int).T
            assert np.unique(np.stack([x, y])[:, mask[y, x]], axis=1).shape[1] > 200


def test_a_screen_hides_the_cards_in_half_of_the_views(load: Load) -> None:
    data = load("hidden")
    share = shares(data, cameras(data), "box of cards")
    assert 0.4 <= (share == 0).mean() <= 0.6
    assert (share[share > 0] > 0.02).all()
    found = [data.truth.mask(view, "box of cards").any() for view in data.truth.test_views]
    assert found == [True, True, False]


def test_all_frontal_cameras_look_the_same_way(load: Load) -> None:
    data = load("frontal")
    forward = np.stack([camera.forward for camera in cameras(data)])
    yaw = np.degrees(np.arctan2(forward[:, 0], forward[:, 1]))
    assert np.abs(yaw).max() <= 20 and np.ptp(yaw) > 30
    pitch = np.degrees(np.arcsin(-forward[:, 2]))
    assert pitch.min() >= 4 and pitch.max() <= 12


def test_floaters_veil_the_pictures_and_hide_nothing(shared: Path, load: Load) -> None:
    data = load("floaters")
    gaussians = data.scene.gaussians
    blobs = np.arange(len(gaussians)) >= len(gaussians) - 400
    plant = gaussians.means[data.truth.flags("houseplant")]
    height = np.ptp(np.percentile(plant[:, 2], [1, 99]))
    assert 0.01 * height < gaussians.scales[blobs].min()
    assert gaussians.scales[blobs].max() < 0.06 * height
    assert gaussians.opacities[blobs].max() <= 0.6
    assert (gaussians.means[blobs, 2] > plant[:, 2].max()).mean() > 0.2
    renderer = get_renderer("numba")
    lit = gaussians.recoloured(blobs[:, None].astype(np.float32))
    veiled = [renderer.render(lit, c.resized(*SMALL)).rgb[..., 0] > 0.1 for c in cameras(data)]
    part = np.mean(veiled, axis=(1, 2))
    assert part.min() > 0.15 and part.max() < 0.8
    clear = composed(shared, "floaters", floaters=None)
    assert len(clear.gaussians) == len(gaussians) - 400
    for i in range(0, 16, 5):
        mask = masks(data, [cameras(data)[i]], "houseplant")[0]
        camera = clear.cameras[f"view_{i:03d}"].resized(*SMALL)
        whole = visible(renderer, clear.gaussians, clear.labels, 3, camera)[0]
        assert 0.5 < (mask & whole).sum() / whole.sum() < 1


def test_the_lawn_fills_a_large_part_of_the_views(load: Load) -> None:
    data = load("stuff")
    assert (shares(data, cameras(data), "lawn") > 0.3).mean() == 1
    means, lawn = data.scene.gaussians.means, data.truth.flags("lawn")
    assert np.ptp(means[lawn, 2]) < 1e-6
    others = means[data.truth.labels == -1]
    assert not (np.abs(others[:, :2]) < 2.3).all(axis=1).any()
    for name in ("houseplant", "cat"):
        thing = means[data.truth.flags(name)]
        assert (np.abs(thing[:, :2]) < 2.3).all() and np.percentile(thing[:, 2], 1) < 0.03


def test_the_cameras_of_the_tilted_world_mislead_about_up(shared: Path, load: Load) -> None:
    data, true = load("tilted"), composed(shared, "tilted")
    off = np.degrees(np.arccos(data.scene.up_direction @ true.up))
    assert 10 < off < 40
    assert up_vector(cameras(data)).dispersion_degrees > 10
    assert np.degrees(np.arccos(true.up[2])) > 30
    # the ground is level in the true sense
    ground = data.scene.gaussians.means[data.truth.labels == -1].astype(np.float64)
    assert np.ptp(ground @ true.up) < 1e-4


def test_the_hundredfold_world_looks_the_same(shared: Path, load: Load) -> None:
    data = load("hundredfold")
    twin = composed(shared, "hundredfold", world=None)
    np.testing.assert_allclose(
        data.scene.gaussians.means, 100 * twin.gaussians.means + (1500, -800, 400), atol=1e-3
    )
    renderer = get_renderer("numba")
    for view in (data.scene.views[0], data.scene.views[9], data.truth.test_views[1]):
        here = renderer.render(data.scene.gaussians, view.camera).rgb
        there = renderer.render(twin.gaussians, twin.cameras[view.name]).rgb
        assert np.abs(here - there).mean() < 1e-3
        assert (np.abs(here - there) > 0.03).mean() < 1e-3
    centres = np.stack([camera.position for camera in cameras(data)])
    assert np.linalg.norm(centres.mean(axis=0)) > 1000
    assert np.linalg.norm(np.ptp(centres, axis=0)) > 300
