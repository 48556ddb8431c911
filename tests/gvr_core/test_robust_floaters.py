"""Which Gaussians may be drawn in a virtual view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_scene import box, flat_gaussians, two_boxes

from gvr_core.gaussians import Gaussians
from gvr_core.robust.floaters import steady
from gvr_core.transforms import transform_gaussians


def blob(at: tuple[float, float, float], sigma: float = 0.05, opacity: float = 0.95) -> Gaussians:
    one = flat_gaussians(np.array([at]), (1.0, 1.0, 1.0), sigma)
    return replace(one, opacities=np.array([opacity], np.float32))


def surfaces() -> Gaussians:
    """A floor, and a sphere of flat discs, as training leaves them."""
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(1500, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    floor = np.concatenate([rng.uniform(-2.5, 2.5, (2500, 2)), np.zeros((2500, 1))], axis=1)
    means = np.concatenate([normals + np.array([0, 0, 1.5]), floor])
    made = flat_gaussians(means, (0.5, 0.5, 0.5), 0.1)
    scales = made.scales * rng.uniform(0.5, 1.5, made.scales.shape).astype(np.float32)
    scales[:, 2] *= np.float32(0.05)
    return replace(made, scales=scales)


def test_surfaces_stay() -> None:
    assert steady(surfaces()).mean() > 0.99
    assert steady(two_boxes()[0].gaussians).mean() > 0.99


def test_what_hangs_alone_is_faint_or_is_huge_goes() -> None:
    scene = surfaces()
    odd = [
        blob((0, 0, 6)),
        blob((2, 2, 1.5)),
        blob((0.1, 0.1, 0.0), 0.1, opacity=0.04),
        blob((0, 0, 0.5), 8.0),
    ]
    flags = steady(Gaussians.concatenate([scene, *odd]))
    assert flags.dtype == np.bool_
    assert flags[: len(scene)].mean() > 0.99
    assert not flags[len(scene) :].any()
    # the same ones near a surface, solid and of its size, are part of it
    fine = Gaussians.concatenate([scene, blob((0.1, 0.1, 0.0), 0.1, 0.06)])
    assert steady(fine)[-1]


def test_a_few_close_together_still_hang_alone() -> None:
    scene = surfaces()
    rng = np.random.default_rng(1)
    group = flat_gaussians(
        np.array([0, 0, 6.0]) + rng.normal(0, 0.05, (6, 3)), (1.0, 1.0, 1.0), 0.05
    )
    flags = steady(Gaussians.concatenate([scene, group]))
    assert not flags[-6:].any()


def test_faint_ones_are_no_company() -> None:
    """A solid one inside of a faint cloud is as alone as without it."""
    scene = surfaces()
    haze = flat_gaussians(box((0, 0, 6), 0.2, 4), (1.0, 1.0, 1.0), 0.05)
    haze = replace(haze, opacities=np.full(len(haze), 0.02, np.float32))
    flags = steady(Gaussians.concatenate([scene, haze, blob((0, 0, 6))]))
    assert not flags[len(scene) :].any()


def test_where_hardly_any_would_be_left_all_are_drawn() -> None:
    rng = np.random.default_rng(2)
    lonely = flat_gaussians(rng.uniform(-50, 50, (300, 3)), (1.0, 1.0, 1.0), 0.01)
    assert steady(lonely).all()
    faint = replace(surfaces(), opacities=np.full(4000, 0.01, np.float32))
    assert steady(faint).all()


@pytest.mark.parametrize("n", [1, 2, 8, 9])
def test_a_handful_of_gaussians_is_drawn(n: int) -> None:
    few = flat_gaussians(np.linspace((0, 0, 0), (0.1, 0, 0), n), (1.0, 1.0, 1.0), 0.1)
    flags = steady(few)
    assert flags.shape == (n,) and flags.all()


@pytest.mark.parametrize("scale", [0.01, 100.0])
def test_the_unit_does_not_matter(scale: float) -> None:
    scene = Gaussians.concatenate([surfaces(), blob((0, 0, 6)), blob((0, 0, 0.5), 8.0)])
    plain = steady(scene)
    assert not plain[-2:].any()
    np.testing.assert_array_equal(steady(transform_gaussians(scene, scale=scale)), plain)
