"""The CPU renderer against the float64 reference."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from render_scenes import camera, cloud, float32, front_camera, gaussians_of, one_torch_thread

from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.gaussians import SH_C0, Gaussians
from gvr_core.rendering import Rendering
from gvr_core.rendering.base import NEAR
from gvr_core.rendering.margins import decision_margins
from gvr_core.rendering.numba_renderer import NumbaRenderer
from gvr_core.rendering.torch_reference import TorchReference

BACKGROUND = (0.2, 0.5, 0.9)
P999, MOST = 1e-5, 1e-4
"""The bars: 99.9 % of the pixels, and all of them away from decisions."""
NEAR_ALPHA, NEAR_STOP, NEAR_MEDIAN = 1e-5, 1e-3, 1e-5
"""Margins, relative, within which rounding in float32 may turn a decision over."""


@pytest.fixture(autouse=True)
def _plain_torch() -> Iterator[None]:
    with one_torch_thread():
        yield


@dataclass(frozen=True)
class Flips:
    """Pixels that may differ by a decision, and those that do."""

    possible: int
    seen: int


def check_agreement(
    gaussians: Gaussians, view: Camera, mask: NDArray[np.float32]
) -> tuple[Rendering, Flips]:
    """Hold one picture to the bars of accuracy; gives it back with the flips counted."""
    ours = NumbaRenderer().render(gaussians, view, BACKGROUND, mask)
    truth = TorchReference().render(gaussians, view, BACKGROUND, mask)
    margins = decision_margins(gaussians, view)
    at_alpha, at_stop = margins.alpha < NEAR_ALPHA, margins.stop < NEAR_STOP
    away = ~(at_alpha | at_stop)
    most_colour = max(1.0, float(truth.rgb.max()))

    colour = np.abs(ours.rgb - truth.rgb).max(axis=2)
    alpha = np.abs(ours.alpha - truth.alpha)
    for error in (colour, alpha):
        assert np.quantile(error, 0.999) <= P999
        assert error[away].max(initial=0) <= MOST
    # An alpha of 1/255 more or less, on all that lies behind it; at the stop, at most the last
    # Gaussian's weight, which is below T = 1e-4 / (1 - 0.999) before it.
    assert colour[at_alpha & ~at_stop].max(initial=0) <= 3 / 255 * most_colour
    assert colour[at_stop].max(initial=0) <= 0.1 * most_colour

    drawn = away & (truth.alpha > 0)
    depth = np.abs(ours.expected_depth - truth.expected_depth) / np.maximum(
        truth.expected_depth, NEAR
    )
    assert np.quantile(depth[drawn], 0.999) <= P999 if drawn.any() else True
    assert depth[drawn].max(initial=0) <= MOST
    np.testing.assert_array_equal(ours.alpha[away] > 0, truth.alpha[away] > 0)
    median = np.abs(ours.median_depth - truth.median_depth)
    same_half = away & (margins.median >= NEAR_MEDIAN)
    assert (median[same_half] <= 1e-6 * truth.median_depth[same_half]).all()

    flipped = (colour > MOST) | (alpha > MOST)
    flips = Flips(int((~away).sum()), int(flipped.sum()))
    assert not flipped[away].any()
    for name in ("weight_inside", "weight_outside"):
        mine, theirs = getattr(ours, name), getattr(truth, name)
        error = np.abs(mine - theirs) / np.maximum(theirs, 1e-2)
        assert np.quantile(error, 0.99) <= 3 * P999
        # Each flip moves at most 1/255 (at the stop 0.1) of weight between Gaussians.
        bound = 2 / 255 * at_alpha.sum() + 0.1 * at_stop.sum()
        assert (np.abs(mine - theirs) <= MOST * np.maximum(theirs, 1) + bound).all()
    return ours, flips


def random_mask(view: Camera) -> NDArray[np.float32]:
    soft = np.random.default_rng(1).random((view.height, view.width), dtype=np.float32)
    soft[: view.height // 3] = 0
    soft[-view.height // 3 :] = 1
    return soft


@pytest.mark.parametrize(
    ("degree", "size", "seed"),
    [(0, 1.0, 0), (1, 0.1, 1), (2, 3.0, 2), (3, 0.02, 3), (3, 1.0, 4), (0, 20.0, 5)],
    ids=["mixed", "small", "large", "pixel-sized", "degree-3", "huge"],
)
def test_clouds_agree_with_the_reference(degree: int, size: float, seed: int) -> None:
    view = camera()
    gaussians = cloud(seed, 3000, degree, size)
    behind = view.to_camera(gaussians.means)[:, 2] < NEAR
    assert 100 < behind.sum() < 2900  # some of the cloud is behind the camera
    rendering, flips = check_agreement(gaussians, view, random_mask(view))
    assert rendering.alpha.max() > 0.5
    assert flips.possible <= 0.1 * rendering.alpha.size
    assert flips.seen <= 5


@pytest.mark.parametrize(
    "view",
    [
        camera(64, 48, eye=(4, 0, 1)),
        camera(200, 31, fov=110.0),
        camera(90, 120, offset=(30.0, -41.0), aspect=1.4),
        camera(17, 17, eye=(0, 0, 6), target=(0, 0, 0), fov=20.0),
        camera(1, 1),
    ],
    ids=["outside", "wide", "off-centre", "from-above", "one-pixel"],
)
def test_cameras_agree_with_the_reference(view: Camera) -> None:
    check_agreement(cloud(7, 2500, 2), view, random_mask(view))


def test_a_scene_far_from_the_origin_is_as_accurate() -> None:
    far = np.array([900.0, -1100.0, 1000.0])
    view = camera(eye=far + np.array([1.2, 0.5, 0.3]), target=far - np.array([0.2, 0.3, 0]))
    check_agreement(cloud(8, 3000, 3, centre=far), view, random_mask(view))


def test_pixel_sized_gaussians_at_the_right_edge_of_a_large_picture() -> None:
    # At x = 2000 float32 resolves 1e-4 pixels, which shows in Gaussians of one pixel.
    rng = np.random.default_rng(9)
    wide = Camera(np.array([[1500, 0, 1024.5], [0, 1500, 40], [0, 0, 1]]), np.eye(4), 2048, 80)
    z = rng.uniform(2, 4, 4000)
    u = np.stack([rng.uniform(1800, 2048, 4000), rng.uniform(0, 80, 4000)], axis=1)
    means = np.column_stack([(u - (1024.5, 40)) / 1500, np.ones(4000)]) * z[:, None]
    gaussians = gaussians_of(means, 1e-4, rng.uniform(0.3, 1, 4000), rng.random((4000, 3)))
    rendering, _ = check_agreement(gaussians, wide, random_mask(wide))
    assert (rendering.alpha > 0).sum() > 4000


def test_long_needles_across_the_picture() -> None:
    # 200 times as long as wide: sums of the inverse covariance's terms cancel to a thousandth.
    rng = np.random.default_rng(10)
    means = np.column_stack([rng.uniform(-1, 1, (300, 2)), rng.uniform(1.5, 3, 300)])
    angle = rng.uniform(0, np.pi, 300)
    quats = np.column_stack([np.cos(angle), 0 * angle, 0 * angle, np.sin(angle)])
    gaussians = gaussians_of(
        means, (1.0, 1e-3, 1e-3), rng.uniform(0.05, 0.6, 300), rng.random((300, 3)), quats
    )
    view = front_camera(200, 160, 180.0)
    rendering, _ = check_agreement(gaussians, view, random_mask(view))
    assert rendering.alpha.mean() > 0.1


@pytest.mark.parametrize("where", ["behind", "beside", "transparent"])
def test_an_empty_view_is_the_background(where: str) -> None:
    mean = {"behind": (0, 0, -2), "beside": (50, 0, 2), "transparent": (0, 0, 2)}[where]
    opacity = 1 / 256 if where == "transparent" else 0.9
    gaussians = gaussians_of([mean, mean], 0.05, [opacity, opacity], [1, 0, 0])
    view = front_camera()
    for renderer in (NumbaRenderer(), TorchReference()):
        picture = renderer.render(gaussians, view, BACKGROUND, random_mask(view))
        np.testing.assert_array_equal(
            picture.rgb, np.broadcast_to(float32(BACKGROUND), picture.rgb.shape)
        )
        for zero in ("alpha", "expected_depth", "median_depth", "weight_inside", "weight_outside"):
            assert not getattr(picture, zero).any()


def test_a_decision_at_its_threshold_is_told_apart() -> None:
    # On the axis alpha is the opacity: 1/255 to within 1e-7, and far from it.
    view = front_camera()
    for opacity, near in ((1 / 255, True), (0.02, False)):
        gaussians = gaussians_of([[0, 0, 2]], 1e-4, [opacity], [1, 1, 1])
        margins = decision_margins(gaussians, view)
        assert (margins.alpha[16, 16] < NEAR_ALPHA) == near
        assert margins.stop[16, 16] > 1
    half = gaussians_of([[0, 0, 2]], 1e-4, [0.5], [1, 1, 1])
    assert decision_margins(half, view).median[16, 16] < NEAR_MEDIAN
    # T = 0.01 twice is 1e-4.
    twice = gaussians_of([[0, 0, 2], [0, 0, 3]], 1e-4, [0.99, 0.99], [1, 1, 1])
    assert decision_margins(twice, view).stop[16, 16] < NEAR_STOP
    assert np.isinf(margins.alpha[0, 0]) or margins.alpha[0, 0] > 0.5


def test_a_real_capture_agrees_with_the_reference(shared: Path) -> None:
    record = np.dtype(
        [("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)]
    )
    raw = np.fromfile(shared / "data" / "splats" / "plant.splat", record)[::4]
    colour = (raw["rgba"][:, :3] / 255 - 0.5) / SH_C0
    gaussians = Gaussians(
        float32(raw["mean"]),
        float32(raw["scale"]),
        float32(raw["quat"] / 128.0 - 1),
        float32(raw["rgba"][:, 3] / 255),
        float32(colour[:, None, :]),
    )
    middle = np.median(gaussians.means, axis=0)
    spread = float(np.percentile(np.linalg.norm(gaussians.means - middle, axis=1), 90))
    eye = middle + spread * np.array([1.2, -0.8, -1.6])
    view = Camera(intrinsics(55, 200, 150), look_at(eye, middle, (0, -1, 0)), 200, 150)
    rendering, flips = check_agreement(gaussians, view, random_mask(view))
    assert rendering.alpha.mean() > 0.05
    assert flips.seen <= 10
