from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y

from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.errors import SplatFormatError
from gvr_core.gaussians import Gaussians
from gvr_core.rendering.base import get_renderer
from gvr_core.transforms import rotate_sh, sh_basis, transform_gaussians


def random_gaussians(seed: int, n: int = 20, k: int = 16) -> Gaussians:
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(n, 4))
    return Gaussians(
        rng.normal(size=(n, 3)).astype(np.float32),
        rng.uniform(0.01, 0.5, (n, 3)).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        rng.uniform(0.1, 1, n).astype(np.float32),
        rng.normal(size=(n, k, 3)).astype(np.float32),
    )


def random_rotation(seed: int) -> NDArray[np.float64]:
    return Rotation.random(random_state=seed).as_matrix()


def unit_rows(seed: int, n: int) -> NDArray[np.float64]:
    d = np.random.default_rng(seed).normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def covariances(g: Gaussians) -> NDArray[np.float64]:
    r = Rotation.from_quat(g.quats.astype(np.float64), scalar_first=True).as_matrix()
    m = r * g.scales[:, None, :]
    return m @ m.transpose(0, 2, 1)


def assert_same(a: Gaussians, b: Gaussians) -> None:
    np.testing.assert_allclose(a.means, b.means, atol=2e-5)
    np.testing.assert_allclose(covariances(a), covariances(b), atol=2e-6)
    np.testing.assert_allclose(a.sh, b.sh, atol=2e-5)
    np.testing.assert_array_equal(a.opacities, b.opacities)


def test_sh_basis_agrees_with_scipys_complex_harmonics() -> None:
    d = unit_rows(0, 50)
    theta, phi = np.arccos(d[:, 2]), np.arctan2(d[:, 1], d[:, 0])
    basis = sh_basis(d, 3)
    for degree in range(4):
        for m in range(-degree, degree + 1):
            # scipy's Y carries the Condon-Shortley phase (-1)^m, as the real ones here do
            value = sph_harm_y(degree, abs(m), theta, phi)
            expected = value.real if m >= 0 else value.imag
            expected = expected * (1 if m == 0 else np.sqrt(2))
            np.testing.assert_allclose(basis[:, degree**2 + degree + m], expected, atol=1e-12)


@pytest.mark.parametrize("k", [1, 4, 9, 16])
def test_turned_colours_are_those_seen_before_from_the_turned_back_direction(k: int) -> None:
    g, r = random_gaussians(1, k=k), random_rotation(2)
    turned = transform_gaussians(g, r, (1, 2, 3), 0.3)
    d, degree = unit_rows(3, 40), round(k**0.5) - 1
    before = np.einsum("dk,nkc->ndc", sh_basis(d, degree), g.sh)
    after = np.einsum("dk,nkc->ndc", sh_basis(d @ r.T, degree), turned.sh)
    np.testing.assert_allclose(after, before, atol=3e-5)
    assert turned.sh.shape == g.sh.shape and turned.sh.dtype == np.float32


def test_means_and_covariances_follow_the_formula() -> None:
    g, r, t, s = random_gaussians(4), random_rotation(5), np.array([0.5, -1, 2]), 1.7
    moved = transform_gaussians(g, r, t, s)
    np.testing.assert_allclose(moved.means, s * g.means @ r.T + t, atol=1e-5)
    np.testing.assert_allclose(covariances(moved), s * s * r @ covariances(g) @ r.T, atol=1e-5)
    for name in ("means", "scales", "quats", "opacities", "sh"):
        assert getattr(moved, name).dtype == np.float32


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 10_000), st.floats(0.2, 4), st.floats(0.2, 4))
def test_group_axioms(seed_a: int, seed_b: int, sa: float, sb: float) -> None:
    g, ra, rb = random_gaussians(6, n=5), random_rotation(seed_a), random_rotation(seed_b)
    ta, tb = unit_rows(seed_a, 1)[0], unit_rows(seed_b, 1)[0]
    one_by_one = transform_gaussians(transform_gaussians(g, ra, ta, sa), rb, tb, sb)
    at_once = transform_gaussians(g, rb @ ra, sb * rb @ ta + tb, sb * sa)
    np.testing.assert_allclose(one_by_one.means, at_once.means, atol=1e-4)
    np.testing.assert_allclose(covariances(one_by_one), covariances(at_once), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(one_by_one.sh, at_once.sh, atol=3e-5)
    back = transform_gaussians(
        one_by_one, (rb @ ra).T, -(rb @ ra).T @ (sb * rb @ ta + tb) / sa / sb, 1 / (sa * sb)
    )
    np.testing.assert_allclose(back.means, g.means, atol=1e-4)
    np.testing.assert_allclose(back.sh, g.sh, atol=5e-5)


def test_identity_changes_nothing() -> None:
    g = random_gaussians(7)
    assert_same(transform_gaussians(g), g)


def test_bands_keep_their_energy() -> None:
    g = random_gaussians(8)
    turned = rotate_sh(g.sh, random_rotation(9))
    for first, last in ((0, 1), (1, 4), (4, 9), (9, 16)):
        np.testing.assert_allclose(
            np.square(turned[:, first:last]).sum(axis=1),
            np.square(g.sh[:, first:last]).sum(axis=1),
            rtol=1e-4,
        )
    assert np.abs(turned[:, 1:] - g.sh[:, 1:]).max() > 0.1


@pytest.mark.parametrize(
    "rotation, translation, scale",
    [
        (np.diag([1.0, 1.0, -1.0]), None, 1.0),  # a mirror
        (np.eye(3) * 2, None, 1.0),  # a scale hidden in the rotation
        (np.full((3, 3), np.nan), None, 1.0),
        (np.eye(4), None, 1.0),
        (None, (0, 0), 1.0),
        (None, (0, np.inf, 0), 1.0),
        (None, None, 0.0),
        (None, None, -1.0),
        (None, None, float("nan")),
    ],
)
def test_what_is_no_similarity_is_refused(rotation, translation, scale) -> None:
    with pytest.raises(SplatFormatError, match="accepted"):
        transform_gaussians(random_gaussians(10), rotation, translation, scale)


def test_a_turned_scene_looks_the_same_to_a_camera_turned_along() -> None:
    g, r, t, s = random_gaussians(11, n=60), random_rotation(12), np.array([2.0, -1, 0.5]), 0.8
    eye, target, up = np.array([0.0, -5, 1]), np.zeros(3), np.array([0.0, 0, 1])
    k = intrinsics(60, 64, 48)
    before = Camera(k, look_at(eye, target, up), 64, 48)
    after = Camera(k, look_at(s * r @ eye + t, s * r @ target + t, r @ up), 64, 48)
    renderer = get_renderer("numba")
    expected = renderer.render(g, before)
    turned = transform_gaussians(g, r, t, s)
    assert expected.alpha.max() > 0.9 and expected.rgb.std() > 0.1
    # single pixels may flip at the 1/255 threshold
    assert np.percentile(np.abs(renderer.render(turned, after).rgb - expected.rgb), 99.5) < 1e-4
    unturned_colours = replace(turned, sh=g.sh)
    wrong = np.abs(renderer.render(unturned_colours, after).rgb - expected.rgb)
    assert np.percentile(wrong, 99.5) > 0.05
