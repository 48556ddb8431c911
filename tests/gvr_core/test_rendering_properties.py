"""What holds for every picture of the CPU renderer, on scenes that hypothesis makes up."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from render_scenes import camera, cloud, float32
from scipy.spatial.transform import Rotation

from gvr_core.cameras import Camera
from gvr_core.gaussians import Gaussians
from gvr_core.rendering import Rendering
from gvr_core.rendering.numba_renderer import NumbaRenderer

RENDERER = NumbaRenderer()
seeds = st.integers(0, 2**32 - 1)
counts = st.integers(1, 400)
sizes = st.floats(0.05, 20)
degrees = st.integers(0, 3)
views = st.builds(
    camera,
    width=st.integers(1, 70),
    height=st.integers(1, 50),
    eye=st.tuples(*[st.floats(1, 4)] * 3),
    fov=st.floats(20, 120),
)
few = settings(max_examples=40, deadline=None)


def masked(seed: int, view: Camera) -> np.ndarray:
    return np.random.default_rng(seed).random((view.height, view.width), dtype=np.float32)


def assert_same(one: Rendering, other: Rendering) -> None:
    for field in fields(Rendering):
        np.testing.assert_array_equal(
            getattr(one, field.name), getattr(other, field.name), err_msg=field.name
        )


@few
@given(seeds, counts, degrees, sizes, views)
def test_numbers_keep_to_their_ranges(
    seed: int, n: int, degree: int, size: float, view: Camera
) -> None:
    gaussians = cloud(seed, n, degree, size)
    picture = RENDERER.render(gaussians, view, (0.5, 0.5, 0.5), masked(seed, view))
    assert picture.rgb.shape == (view.height, view.width, 3)
    assert (picture.alpha >= 0).all()
    assert (picture.alpha <= 1 - 0.99e-4).all()  # T stays above 1e-4
    assert (picture.rgb >= 0).all()
    z = view.to_camera(gaussians.means)[:, 2]
    covered = picture.alpha > 0
    for depth in (picture.expected_depth, picture.median_depth):
        assert not depth[~covered].any()
        assert (depth[covered] <= z.max() * (1 + 1e-5)).all()
    assert (
        picture.expected_depth[covered] >= z[z >= 0.0099].min(initial=np.inf) * (1 - 1e-5)
    ).all()
    # T crosses 0.5 where the picture is more than half opaque.
    np.testing.assert_array_equal(
        picture.median_depth[abs(picture.alpha - 0.5) > 1e-6] > 0,
        picture.alpha[abs(picture.alpha - 0.5) > 1e-6] > 0.5,
    )


@few
@given(seeds, counts, sizes, views)
def test_weights_add_up_to_the_opacity(seed: int, n: int, size: float, view: Camera) -> None:
    gaussians = cloud(seed, n, 0, size)
    mask = masked(seed, view)
    picture = RENDERER.render(gaussians, view, mask=mask)
    assert picture.weight_inside is not None
    assert picture.weight_outside is not None
    alpha = picture.alpha.astype(np.float64)
    pixels = alpha.size
    for weights, share in ((picture.weight_inside, mask), (picture.weight_outside, 1 - mask)):
        assert (weights >= 0).all()
        assert weights.sum(dtype=np.float64) == pytest.approx(
            (alpha * share).sum(), rel=1e-5, abs=1e-6 * pixels
        )
    # The split does not change the whole, nor the picture.
    whole = RENDERER.render(gaussians, view, mask=np.ones_like(mask))
    assert whole.weight_inside is not None
    assert whole.weight_outside is not None
    assert not whole.weight_outside.any()
    np.testing.assert_allclose(
        picture.weight_inside + picture.weight_outside, whole.weight_inside, rtol=1e-5, atol=1e-6
    )
    bare = RENDERER.render(gaussians, view)
    for name in ("rgb", "alpha", "expected_depth", "median_depth"):
        np.testing.assert_array_equal(getattr(bare, name), getattr(picture, name))


@few
@given(seeds, counts, degrees, sizes, views)
def test_the_order_of_the_set_does_not_matter(
    seed: int, n: int, degree: int, size: float, view: Camera
) -> None:
    gaussians = cloud(seed, n, degree, size)
    order = np.random.default_rng(seed).permutation(n)
    mask = masked(seed, view)
    one = RENDERER.render(gaussians, view, mask=mask)
    other = RENDERER.render(gaussians.subset(order), view, mask=mask)
    assert one.weight_inside is not None
    assert one.weight_outside is not None
    # Depths are all different, so that not one bit depends on the order.
    moved = Rendering(
        one.rgb,
        one.alpha,
        one.expected_depth,
        one.median_depth,
        one.weight_inside[order],
        one.weight_outside[order],
    )
    assert_same(moved, other)


@few
@given(seeds, st.integers(1, 80), sizes, views)
def test_moving_scene_and_camera_together_changes_nothing(
    seed: int, n: int, size: float, view: Camera
) -> None:
    rng = np.random.default_rng(seed)
    gaussians = cloud(seed, n, 0, size)
    turn = Rotation.random(random_state=rng)
    shift = rng.normal(0, 5, 3)
    local = Rotation.from_quat(gaussians.quats, scalar_first=True)
    moved = Gaussians(
        float32(turn.apply(gaussians.means) + shift),
        gaussians.scales,
        float32((turn * local).as_quat(scalar_first=True)),
        gaussians.opacities,
        gaussians.sh,
    )
    back = np.eye(4)
    back[:3, :3] = turn.inv().as_matrix()
    back[:3, 3] = -back[:3, :3] @ shift
    followed = Camera(view.K, view.world_to_camera @ back, view.width, view.height)
    one, other = RENDERER.render(gaussians, view), RENDERER.render(moved, followed)
    # float32 means move by 1e-6 of a unit, which a pixel-sized Gaussian near the camera shows.
    for name in ("rgb", "alpha"):
        error = np.abs(getattr(one, name) - getattr(other, name))
        assert np.quantile(error, 0.98) < 1e-3
        assert np.median(error) < 1e-5


@few
@given(seeds, st.integers(1, 20), sizes, views)
def test_what_has_no_weight_can_be_left_out(seed: int, n: int, size: float, view: Camera) -> None:
    # So faint that T stays above 0.7^20 = 8e-4: without the one that stops the blending, which
    # has no weight either, those behind it would be drawn.
    cloudy = cloud(seed, n, 0, size)
    gaussians = replace(cloudy, opacities=cloudy.opacities * np.float32(0.3))
    mask = np.ones((view.height, view.width), np.float32)
    one = RENDERER.render(gaussians, view, mask=mask)
    assert one.weight_inside is not None
    drawn = one.weight_inside > 0
    if not drawn.any():
        assert not one.alpha.any()
        return
    other = RENDERER.render(gaussians.subset(drawn), view, mask=mask)
    np.testing.assert_array_equal(one.rgb, other.rgb)
    np.testing.assert_array_equal(one.median_depth, other.median_depth)
    np.testing.assert_array_equal(one.weight_inside[drawn], other.weight_inside)
