"""Similarity transforms of Gaussians: turn, scale and move a set, its view-dependent colour too.

Conventions: x' = scale * R x + t, world frame. Colours are real spherical harmonics in the order
and with the signs of Kerbl et al. 2023 ("3D Gaussian Splatting for Real-Time Radiance Field
Rendering"), evaluated in the world direction from the camera to the Gaussian.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gvr_core.errors import SplatFormatError
from gvr_core.gaussians import SH_C0, Gaussians

Float64Array = NDArray[np.float64]

_BANDS = ((0, 1), (1, 4), (4, 9), (9, 16))
"""Coefficients [first, last) of each band l = 0..3: 2 l + 1 of them."""


def sh_basis(directions: ArrayLike, degree: int) -> Float64Array:
    """Real spherical harmonics in unit directions.

    Args:
        directions: (..., 3) unit vectors.
        degree: Highest band, 0 to 3.

    Returns:
        (..., (degree + 1)^2) float64, Y_lm in the order l = 0..degree, m = -l..l.
    """
    d = np.asarray(directions, dtype=np.float64)
    x, y, z = d[..., 0], d[..., 1], d[..., 2]
    xx, yy, zz = x * x, y * y, z * z
    terms = [np.full(x.shape, SH_C0)]
    if degree > 0:
        c = np.sqrt(3 / (4 * np.pi))
        terms += [-c * y, c * z, -c * x]
    if degree > 1:
        c, c0 = np.sqrt(15 / (4 * np.pi)), np.sqrt(5 / (16 * np.pi))
        terms += [c * x * y, -c * y * z, c0 * (2 * zz - xx - yy), -c * x * z, c / 2 * (xx - yy)]
    if degree > 2:
        c3, c2 = np.sqrt(35 / (32 * np.pi)), np.sqrt(105 / (4 * np.pi))
        c1, c0 = np.sqrt(21 / (32 * np.pi)), np.sqrt(7 / (16 * np.pi))
        terms += [
            -c3 * y * (3 * xx - yy),
            c2 * x * y * z,
            -c1 * y * (4 * zz - xx - yy),
            c0 * z * (2 * zz - 3 * xx - 3 * yy),
            -c1 * x * (4 * zz - xx - yy),
            c2 / 2 * z * (xx - yy),
            -c3 * x * (xx - 3 * yy),
        ]
    return np.stack(terms, axis=-1)


def rotate_sh(sh: NDArray[np.float32], rotation: Float64Array) -> NDArray[np.float32]:
    """Coefficients of the same colours seen from directions turned along with the object.

    A rotation maps each band onto itself, so its matrix follows from sampled directions: the
    turned function at d is the old one at R^T d, and the band is fitted to that exactly.

    Args:
        sh: (N, K, 3) float32 coefficients, K in (1, 4, 9, 16).
        rotation: (3, 3) rotation of the object.

    Returns:
        (N, K, 3) float32.
    """
    directions = _spread_directions(64)
    degree = round(sh.shape[1] ** 0.5) - 1
    here = sh_basis(directions, degree)
    before = sh_basis(directions @ rotation, degree)  # rows R^T d
    turned = sh.copy()
    for first, last in _BANDS[1 : degree + 1]:
        matrix = np.linalg.lstsq(here[:, first:last], before[:, first:last], rcond=None)[0]
        turned[:, first:last] = np.einsum(
            "ij,njc->nic", matrix.astype(np.float32), sh[:, first:last]
        )
    return turned


def transform_gaussians(
    gaussians: Gaussians,
    rotation: ArrayLike | None = None,
    translation: ArrayLike | None = None,
    scale: float = 1.0,
) -> Gaussians:
    """A set of Gaussians turned, scaled and moved: x' = scale * R x + t.

    Args:
        gaussians: The set; it stays as it is.
        rotation: (3, 3) rotation R; None for no turn.
        translation: (3,) vector t, scene units after scaling; None for no move.
        scale: Positive factor.

    Returns:
        Gaussians of the same degree, float32.

    Raises:
        SplatFormatError: if R is not a proper rotation, or the scale is not positive.
    """
    turn = np.eye(3) if rotation is None else np.asarray(rotation, np.float64)
    move = np.zeros(3) if translation is None else np.asarray(translation, np.float64)
    _check(turn, move, scale)
    means = scale * gaussians.means.astype(np.float64) @ turn.T + move
    matrix = Rotation.from_matrix(turn)
    quats = _multiply(matrix.as_quat(scalar_first=True), gaussians.quats.astype(np.float64))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return Gaussians(
        means.astype(np.float32),
        (gaussians.scales * np.float32(scale)).astype(np.float32),
        quats.astype(np.float32),
        gaussians.opacities,
        rotate_sh(gaussians.sh, turn),
    )


def _check(turn: Float64Array, move: Float64Array, scale: float) -> None:
    """Refuse anything but a similarity that keeps the handedness."""
    if turn.shape != (3, 3) or move.shape != (3,):
        raise SplatFormatError(
            f"rotation is {turn.shape}, translation is {move.shape}", accepted="(3, 3) and (3,)"
        )
    finite = np.isfinite(turn).all() and np.isfinite(move).all()
    if not (
        finite and np.allclose(turn @ turn.T, np.eye(3), atol=1e-5) and np.linalg.det(turn) > 0
    ):
        raise SplatFormatError(
            "not a rigid rotation and a finite move",
            accepted="an orthonormal matrix, determinant 1",
        )
    if not (np.isfinite(scale) and scale > 0):
        raise SplatFormatError(f"scale {scale}", accepted="a positive number")


def _multiply(a: Float64Array, b: Float64Array) -> Float64Array:
    """Hamilton product of one quaternion (4,) with many (N, 4), all wxyz."""
    w, v = a[0], a[1:]
    scalar = w * b[:, 0] - b[:, 1:] @ v
    vector = w * b[:, 1:] + b[:, :1] * v + np.cross(v, b[:, 1:])
    return np.concatenate([scalar[:, None], vector], axis=1)


def _spread_directions(n: int) -> Float64Array:
    """(n, 3) unit vectors spread evenly over the sphere (a Fibonacci lattice)."""
    i = np.arange(n) + 0.5
    z = 1 - 2 * i / n
    yaw = np.pi * (1 + 5**0.5) * i
    level = np.sqrt(1 - z * z)
    return np.stack([level * np.cos(yaw), level * np.sin(yaw), z], axis=1)
