"""Both renderers against results worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from render_scenes import camera, cloud, float32, front_camera, gaussians_of
from scipy.special import sph_harm_y

from gvr_core.errors import ConfigError, InputError
from gvr_core.gaussians import SH_COUNTS, Gaussians
from gvr_core.rendering import Renderer, get_renderer
from gvr_core.rendering.numba_renderer import NumbaRenderer
from gvr_core.rendering.torch_projection import spherical_harmonics
from gvr_core.rendering.torch_reference import TorchReference

RENDERERS = [NumbaRenderer(), TorchReference(), TorchReference(torch.float32)]
each_renderer = pytest.mark.parametrize("renderer", RENDERERS, ids=lambda r: r.name)
AXIS = (16, 16)
"""The pixel of ``front_camera`` whose centre lies on the optical axis."""


@each_renderer
def test_one_gaussian_is_a_bell_over_the_background(renderer: Renderer) -> None:
    # On the axis the projection is a scaling by f / z: sigma^2 = (40 / 2 * 0.1)^2 + 0.3 pixels.
    gaussians = gaussians_of([[0, 0, 2]], 0.1, [0.8], [1.0, 0.5, 0.25])
    picture = renderer.render(gaussians, front_camera(), background=(0, 1, 0))
    for dx, dy in ((0, 0), (1, 0), (-3, 2), (4, 4)):
        alpha = 0.8 * math.exp(-(dx * dx + dy * dy) / 2 / (4 + 0.3))
        pixel = (AXIS[0] + dy, AXIS[1] + dx)
        assert picture.alpha[pixel] == pytest.approx(alpha, abs=1e-6)
        colour = [alpha, 0.5 * alpha + (1 - alpha), 0.25 * alpha]
        np.testing.assert_allclose(picture.rgb[pixel], colour, atol=1e-6)
        assert picture.expected_depth[pixel] == pytest.approx(2, rel=3e-6)
        assert picture.median_depth[pixel] == (2 if alpha >= 0.5 else 0)
    # 0.8 exp(-d^2 / 8.6) = 1/255 at d = 6.76: seven pixels off nothing is left.
    assert picture.alpha[16, 16 + 6] > 0
    assert picture.alpha[16, 16 + 7] == 0


@each_renderer
def test_two_gaussians_blend_front_to_back(renderer: Renderer) -> None:
    # The nearer one is second in the set. On the axis alpha is the opacity.
    gaussians = gaussians_of([[0, 0, 4], [0, 0, 2]], 1e-4, [0.75, 0.4], [[0, 0, 1], [1, 0, 0]])
    mask = np.zeros((32, 32), np.float32)
    mask[AXIS] = 0.25
    picture = renderer.render(gaussians, front_camera(), mask=mask)
    near, far = 0.4, 0.6 * 0.75
    np.testing.assert_allclose(picture.rgb[AXIS], [near, 0, far], atol=1e-6)
    assert picture.alpha[AXIS] == pytest.approx(near + far, abs=1e-6)
    assert picture.expected_depth[AXIS] == pytest.approx((near * 2 + far * 4) / (near + far))
    assert picture.median_depth[AXIS] == 4  # T: 1, 0.6, 0.15
    assert picture.weight_inside is not None
    assert picture.weight_outside is not None
    np.testing.assert_allclose(picture.weight_inside, [far / 4, near / 4], atol=1e-6)
    total = picture.weight_inside + picture.weight_outside
    # Only the low-pass of 0.3 px spreads them: four neighbours each, exp(-1 / 0.6) as strong.
    side = math.exp(-1 / 0.6)
    corner = math.exp(-2 / 0.6)
    reached = [0.4 * w for w in (1, *[side] * 4, *[corner] * 4)]
    assert total[1] == pytest.approx(sum(w for w in reached if w >= 1 / 255), abs=1e-5)


@each_renderer
def test_equal_depths_are_drawn_in_order_of_index(renderer: Renderer) -> None:
    gaussians = gaussians_of([[0, 0, 2]] * 2, 1e-4, [0.5, 0.5], [[1, 0, 0], [0, 1, 0]])
    picture = renderer.render(gaussians, front_camera())
    np.testing.assert_allclose(picture.rgb[AXIS], [0.5, 0.25, 0], atol=1e-6)


@each_renderer
def test_alpha_is_clamped_and_blending_stops_before_the_limit(renderer: Renderer) -> None:
    # T: 1, 1e-3, 1e-3 * 0.11 = 1.1e-4; the third would take it to 5.5e-5 and is left out, as is
    # the fourth, although it is faint enough to fit.
    gaussians = gaussians_of(
        [[0, 0, 2], [0, 0, 3], [0, 0, 4], [0, 0, 5]],
        1e-4,
        [1, 0.89, 0.5, 0.01],
        [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1]],
    )
    picture = renderer.render(gaussians, front_camera())
    np.testing.assert_allclose(picture.rgb[AXIS], [0.999, 0.00089, 0], atol=2e-7)
    assert picture.alpha[AXIS] == pytest.approx(1 - 1.1e-4, abs=2e-7)


@each_renderer
def test_gaussians_nearer_than_the_near_plane_are_not_drawn(renderer: Renderer) -> None:
    for z, drawn in ((0.0099, False), (0.0101, True), (0.0, False), (-1.0, False)):
        gaussians = gaussians_of([[0, 0, z]], 1e-5, [0.9], [1, 1, 1])
        assert bool(renderer.render(gaussians, front_camera()).alpha.any()) == drawn


@each_renderer
def test_the_jacobian_is_taken_within_1_3_of_the_field_of_view(renderer: Renderer) -> None:
    # Three half fields of view to the right; deep along z, so that only the shear of the Jacobian,
    # -f x / z^2, widens it. tan = 16.5 / 40 to the right, and the margin is 0.3 * 16 / 40.
    slope, depth, scale = 3 * 16 / 40, 2.0, 1.5
    view = front_camera()
    gaussians = gaussians_of([[slope * depth, 0, depth]], (1e-4, 1e-4, scale), [0.9], [1, 1, 1])
    clamped = (32 - 16.5) / 40 + 0.3 * 16 / 40
    variance = (40 * clamped / depth * scale) ** 2 + 0.3
    dx = slope * 40  # from the axis back to the mean
    alpha = 0.9 * math.exp(-dx * dx / 2 / variance)
    assert renderer.render(gaussians, view).alpha[AXIS] == pytest.approx(alpha, rel=1e-4)


@each_renderer
def test_quaternions_turn_local_axes_into_the_world(renderer: Renderer) -> None:
    # A quarter turn about z takes the long x axis to y: tall in the picture, not wide.
    turn = [math.sqrt(0.5), 0, 0, math.sqrt(0.5)]
    for quat in (turn, [3 * q for q in turn]):
        gaussians = gaussians_of([[0, 0, 2]], (0.4, 0.01, 0.01), [0.9], [1, 1, 1], [quat])
        seen = renderer.render(gaussians, front_camera()).alpha > 0.1
        assert seen.any(axis=1).sum() > 20
        assert seen.any(axis=0).sum() <= 3


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_the_basis_is_that_of_real_spherical_harmonics(degree: int) -> None:
    rng = np.random.default_rng(degree)
    directions = rng.normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    theta = np.arccos(directions[:, 2])
    phi = np.arctan2(directions[:, 1], directions[:, 0])
    expected = []
    for n in range(degree + 1):
        for m in range(-n, n + 1):
            # With the Condon-Shortley phase, as in 3D Gaussian Splatting.
            complex_ = sph_harm_y(n, abs(m), theta, phi)
            part = complex_.imag if m < 0 else complex_.real
            expected.append(part * (math.sqrt(2) if m else 1))
    basis = spherical_harmonics(torch.tensor(directions), degree).numpy()
    np.testing.assert_allclose(basis, np.stack(expected, axis=1), atol=1e-12)


@each_renderer
def test_colour_follows_the_direction_from_camera_to_mean(renderer: Renderer) -> None:
    # Only the coefficient of Y_10 = sqrt(3 / 4 pi) z: bright seen along +z, black along -z.
    sh = np.zeros((1, SH_COUNTS[1], 3), np.float32)
    sh[0, 2] = 1.0
    gaussians = Gaussians(
        float32([[0, 0, 2]]), float32([[0.1] * 3]), float32([[1, 0, 0, 0]]), float32([0.9]), sh
    )
    bright = 0.9 * (0.5 + math.sqrt(3 / (4 * math.pi)))
    along = renderer.render(gaussians, front_camera()).rgb[AXIS]
    np.testing.assert_allclose(along, bright, atol=1e-6)  # above 1 is not clipped
    sh[0, 2] = -2.0
    assert not renderer.render(gaussians, front_camera()).rgb[AXIS].any()


@each_renderer
def test_a_mask_or_background_that_does_not_fit_is_refused(renderer: Renderer) -> None:
    gaussians = gaussians_of([[0, 0, 2]], 0.1, [0.9], [1, 1, 1])
    view = front_camera()
    for mask in (
        np.zeros((32, 31)),
        np.zeros(1024),
        np.full((32, 32), 1.01),
        np.full((32, 32), np.nan),
    ):
        with pytest.raises(InputError, match="mask"):
            renderer.render(gaussians, view, mask=float32(mask))
    for background in ((0.0, 0.0), (0.0, 0.0, 1.5), (0.0, float("nan"), 0.0)):
        with pytest.raises(InputError, match="background"):
            renderer.render(gaussians, view, background=background)  # type: ignore[arg-type]


def test_renderers_are_found_by_name() -> None:
    assert get_renderer("numba").name == "numba/1"
    assert get_renderer("torch-reference").name == "torch-reference/1/float64"
    with pytest.raises(ConfigError, match="numba"):
        get_renderer("nvidia")
    with pytest.raises(ConfigError, match="0 threads"):
        NumbaRenderer(threads=0)


def test_extreme_gaussians_leave_the_rest_of_the_picture_alone() -> None:
    """Sizes and places at the ends of float32 draw something or nothing, but no NaN."""
    plain = cloud(0, 50)
    extreme = gaussians_of(
        [[0, 0, 0], [1e30, 0, 0], [0, 3e38, 0], [1e-30, 0, 0], [0, -1e10, 1e10]] * 3,
        np.repeat([1e-38, 1.0, 3e38], 5)[:, None],
        [1.0] * 15,
        [1, 1, 1],
        [[0, 0, 0, 0]] * 15,
    )
    view = camera()
    for renderer in (NumbaRenderer(), NumbaRenderer(threads=1)):
        for part in (extreme, Gaussians.concatenate([plain, extreme])):
            picture = renderer.render(part, view, mask=np.ones((101, 150), np.float32))
            for values in vars(picture).values():
                assert np.isfinite(values).all()
            assert picture.alpha.max() <= 1
