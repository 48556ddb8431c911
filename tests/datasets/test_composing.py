from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_layout import LAYOUT, layouts, write_splats
from small_scene import box, flat_gaussians

from datasets.composing import Composition, compose, place
from datasets.composite import LAYOUTS
from datasets.layout import read_layout
from datasets.layout_objects import SplatTable
from gvr_core.errors import DatasetError
from gvr_core.gaussians import Gaussians
from gvr_core.splat_io import read_splat


@pytest.fixture(scope="module")
def splats(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_splats(tmp_path_factory.mktemp("splats"))


def test_a_splat_with_floaters_can_be_cut(splats: Path) -> None:
    item = read_layout(layouts(splats.parent / "cut") / "pair.toml").objects[0]
    near = flat_gaussians(box((0, 0, 0), 1.0, 6), (0.5, 0.5, 0.5), 0.05)
    far = flat_gaussians(box((50, 0, 0), 1.0, 6), (0.5, 0.5, 0.5), 0.05)
    both = Gaussians.concatenate([near, far])
    (kept,) = place(both, replace_item(item, ((-1, -1, -1), (1, 1, 1))), Path("x.ply"))
    assert len(kept) == 216 and np.ptp(kept.means[:, 0]) < 1
    with pytest.raises(DatasetError, match=r"x\.ply: no Gaussian lies inside keep_within"):
        place(near, replace_item(item, ((5, 5, 5), (6, 6, 6))), Path("x.ply"))
    flat = replace(near, means=near.means * np.float32([1, 0, 1]))
    with pytest.raises(DatasetError, match="flat along its up"):
        place(flat, item, Path("x.ply"))


def replace_item(item, box_corners):
    return item.model_copy(update={"keep_within": box_corners})


def composed(tmp_path: Path, splats: Path, text: str) -> Composition:
    layout = read_layout(layouts(tmp_path / "layouts", text) / "pair.toml")
    return compose(layout, {file: splats / file for file in layout.splats()})


MORE = """
[[objects]]
name = "pet"
photograph = "cat"
size = [0.6, 0.4, 0.5]
pitch = 0.05
yaw = 90
position = [2, 0]
lift = 0.1
copies = [{ position = [-2, 0.5] }, { position = [-2, -1.5], yaw = 90 }]
queries = ["a cat"]

[[objects]]
name = "rug"
texture = "grass"
tint = [0.5, 0.2, 0.2]
size = [2.0, 1.0]
pitch = 0.1
yaw = 90
position = [1, 0]
queries = ["a rug"]

[[surfaces]]
corner = [-1, 2.5, 3]
right = [2, 0, 0]
down = [0, 0, -1]
texture = "wood"
tint = [0.9, 0.9, 0.9]
pitch = 0.1

[floaters]
count = 50
seed = 3
lower = [-1, -2, 1.5]
upper = [1, 2, 2]
size = [0.01, 0.05]
opacity = [0.2, 0.5]
"""


def test_photographs_flat_things_surfaces_and_floaters(tmp_path: Path, splats: Path) -> None:
    made = composed(tmp_path, splats, LAYOUT + MORE)
    assert made.objects == ("red", "blue", "pet", "rug") and made.up == (0, 0, 1)
    means, labels = made.gaussians.means, made.labels
    first, second, third = np.split(means[labels == 2], 3)
    for box_means, middle, size in (
        (first, (2, 0), (0.4, 0.6)),
        (second, (-2, 0.5), (0.6, 0.4)),
        (third, (-2, -1.5), (0.4, 0.6)),
    ):
        low, high = box_means.min(axis=0), box_means.max(axis=0)
        np.testing.assert_allclose((low + high)[:2] / 2, middle, atol=1e-6)
        np.testing.assert_allclose((high - low)[:2], size, atol=1e-6)
        assert high[2] == pytest.approx(0.6) and 0.1 < low[2] < 0.15
    rug, rest = means[labels == 3], means[labels == -1]
    np.testing.assert_allclose(rug[:, 2], 0.01)
    np.testing.assert_allclose([rug.min(0)[:2], rug.max(0)[:2]], [(0.55, -0.95), (1.45, 0.95)])
    # nothing of the ground is left under the rug, and all of it around
    plane = rest[rest[:, 2] == 0]
    under = (np.abs(plane[:, :2] - (1, 0)) < (0.5, 1)).all(axis=1)
    assert not under.any() and len(plane) == 3600 - 200
    wall = rest[np.isclose(rest[:, 1], 2.5)]
    np.testing.assert_allclose(wall.min(axis=0), (-0.95, 2.5, 2.05), atol=1e-6)
    np.testing.assert_allclose(wall.max(axis=0), (0.95, 2.5, 2.95), atol=1e-6)
    blobs = made.gaussians.subset(np.arange(len(means)) >= len(means) - 50)
    assert (blobs.means >= (-1, -2, 1.5)).all() and (blobs.means <= (1, 2, 2)).all()
    assert blobs.scales.min() >= 0.01 and blobs.scales.max() <= 0.05
    assert blobs.opacities.min() >= 0.2 and blobs.opacities.max() <= 0.5
    again = composed(tmp_path, splats, LAYOUT + MORE)
    np.testing.assert_array_equal(again.gaussians.means, means)
    other = composed(tmp_path, splats, LAYOUT + MORE.replace("seed = 3", "seed = 4"))
    assert (other.gaussians.means[-50:] != means[-50:]).all()


def test_a_rug_may_cover_all_of_the_ground(tmp_path: Path, splats: Path) -> None:
    made = composed(tmp_path, splats, LAYOUT + MORE.replace("[2.0, 1.0]", "[12.0, 12.0]"))
    assert (made.labels == -1).sum() == 50 + 200


def test_copies_of_a_splat_are_twins(tmp_path: Path, splats: Path) -> None:
    copies = "height = 0.8\ncopies = [{ position = [2, 1], yaw = 90 }]"
    made = composed(tmp_path, splats, LAYOUT.replace("height = 0.8", copies))
    first, second = np.split(made.gaussians.means[made.labels == 0], 2)
    assert len(first) == 12**3
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose((first - (0, -1, 0)) @ turn.T + (2, 1, 0), second, atol=1e-5)


def test_a_real_splat_stands_upright(shared: Path) -> None:
    path = LAYOUTS / "open.toml"
    item = read_layout(path).objects[0]
    assert isinstance(item, SplatTable)
    (guitar,) = place(read_splat(shared / "data/splats" / item.file), item, path)
    z = guitar.means[:, 2]
    lower, upper = guitar.means[z < 0.4], guitar.means[z > 0.7]
    # the body is below, and wider than the neck
    assert np.ptp(np.percentile(lower[:, 0], [5, 95])) > 2 * np.ptp(
        np.percentile(upper[:, 0], [5, 95])
    )
    assert len(lower) > len(upper)
