"""What a frame's depth says about its layout: support planes and what stands off them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gvr_core.models.base import BoolArray, FloatArray, Frame

Float64Array = NDArray[np.float64]

ALPHA_SHOWN = 0.5
"""A pixel shows something where its accumulated opacity reaches this; there the median depth is
defined, too."""

MAX_PLANES = 3
"""A ground and two walls."""

PLANE_SHARE = 0.08
"""A support plane holds at least this share of what is shown."""

BEHIND_SHARE = 0.02
"""At most this share lies behind a support plane. This is what tells the ground and the walls,
which end the scene, from the flat faces of things, which have something behind them."""

BORDER_SHARE = 0.15
"""A plane with this part of the picture's border runs out of the picture."""

TALL = 0.3
"""What stands on a plane that ends inside the picture rises above it by this part of its size."""

FROM_ABOVE = 0.9
"""Cosine between the optical axis and the normal of a support plane that is seen from above."""

RIM_SHARE = 0.25
"""In front of a support plane, between one and two tolerances, there are at most this many points
for one on it. A slice through something round goes on there with half as many as it holds."""

_TOLERANCE = 0.01
"""First tolerance of a plane's distance, relative to depth."""
_TOLERANCE_RANGE = (0.001, 0.012)
"""Bounds of the tolerance that is measured on the plane's own roughness."""
_SAMPLE = 4000
_TRIALS = 400


@dataclass(frozen=True, eq=False)
class FrameGeometry:
    """Depth cues of a frame, all free of scale."""

    shown: BoolArray
    """(H, W) True where the picture shows something."""
    disparity: FloatArray
    """(H, W) median depth / depth, 1 in the middle of the scene; 0 where nothing is. A plane's
    disparity is linear in the pixel coordinates, however steeply it is seen."""
    plane: NDArray[np.uint8]
    """(H, W) number of the support plane that a pixel lies on, 1 to 3; 0 for none."""

    from_above: bool
    """True where the one support plane is seen along its normal, as in a bird's-eye view."""

    @property
    def has_depth(self) -> bool:
        """False for a photograph without depth."""
        return bool((self.disparity > 0).any())


def frame_geometry(frame: Frame) -> FrameGeometry:
    """The depth cues of a frame.

    A frame whose depth is 0 everywhere counts as a photograph without depth: all of it is shown
    (or what alpha says), and it has no planes.
    """
    depth = np.where(np.isfinite(frame.depth) & (frame.depth > 0), frame.depth, 0)
    opaque = np.ones(depth.shape, np.bool_) if frame.alpha is None else frame.alpha >= ALPHA_SHOWN
    shown = opaque & (depth > 0)
    plane = np.zeros(depth.shape, np.uint8)
    disparity = np.zeros(depth.shape, np.float32)
    if not depth.any():
        return FrameGeometry(opaque, disparity, plane, False)
    if not shown.any():
        return FrameGeometry(shown, disparity, plane, False)
    disparity[shown] = np.median(depth[shown]) / depth[shown]
    rays = _rays(frame)
    remaining = shown.copy()
    normals = []
    for number in range(1, MAX_PLANES + 1):
        found = _support_plane(rays, depth.astype(np.float64), shown, remaining)
        if found is None:
            break
        distance, normal, tolerance = found
        on_plane = remaining & (distance <= tolerance)
        if not _supports(on_plane, remaining & ~on_plane, distance * depth, depth, frame):
            break
        normals.append(normal)
        plane[on_plane] = number
        remaining &= ~on_plane
    from_above = len(normals) == 1 and bool(abs(normals[0][2]) > FROM_ABOVE)
    return FrameGeometry(shown, disparity, plane, from_above)


def _rays(frame: Frame) -> Float64Array:
    """(H, W, 3) points at depth 1 through the pixels' centres, camera frame."""
    height, width = frame.depth.shape
    k = frame.camera.K
    x = (np.arange(width) + 0.5 - k[0, 2]) / k[0, 0]
    y = (np.arange(height) + 0.5 - k[1, 2]) / k[1, 1]
    return np.stack(np.broadcast_arrays(x[None, :], y[:, None], 1.0), axis=-1)


def _support_plane(
    rays: Float64Array, depth: Float64Array, shown: BoolArray, remaining: BoolArray
) -> tuple[Float64Array, Float64Array, float] | None:
    """The plane that holds most of the remaining points and has next to nothing behind it.

    Args:
        rays: (H, W, 3), see :func:`_rays`.
        depth: (H, W) z-depth.
        shown: (H, W) pixels with depth.
        remaining: (H, W) pixels that no earlier plane took.

    Returns:
        (H, W) distance in front of the plane over depth (negative behind it), the plane's unit
        normal (3,) in the camera frame, and up to which distance a pixel lies on the plane; or
        None where there is no such plane.
    """
    n_shown = int(shown.sum())
    if remaining.sum() < PLANE_SHARE * n_shown:
        return None
    generator = np.random.default_rng(0)  # the same trials for the same frame, always
    index = np.flatnonzero(shown)
    sample = index[:: max(1, len(index) // _SAMPLE)]
    flat_rays, flat_depth = rays.reshape(-1, 3), depth.reshape(-1)
    points = flat_rays[sample] * flat_depth[sample, None]
    free = remaining.reshape(-1)[sample]
    normals, offsets = _candidates(rays, depth, remaining, generator)
    if len(normals) == 0:
        return None
    # Distance in front of each candidate, relative to depth.
    distances = (points @ normals.T + offsets) / points[:, 2:]
    inside = (np.abs(distances) < _TOLERANCE) & free[:, None]
    behind = distances < -2 * _TOLERANCE
    share = inside.mean(axis=0)
    allowed = (share >= PLANE_SHARE) & (behind.mean(axis=0) <= BEHIND_SHARE)
    if not allowed.any():
        return None
    best = int(np.argmax(np.where(allowed, share, -1)))
    inliers = inside[:, best]
    for _ in range(3):
        normal, offset = _fit(points[inliers])
        residual = (points @ normal + offset) / points[:, 2]
        inliers = (np.abs(residual) < _TOLERANCE) & free
        if inliers.sum() < 3:
            return None
    rim = (residual >= _TOLERANCE) & (residual < 2 * _TOLERANCE) & free
    if rim.sum() > RIM_SHARE * inliers.sum():
        return None
    spread = 1.4826 * float(np.median(np.abs(residual[inliers])))
    tolerance = float(np.clip(3 * spread, *_TOLERANCE_RANGE))
    safe_depth = np.where(shown, depth, 1.0)
    distance: Float64Array = (rays @ normal) + offset / safe_depth
    return distance, normal, tolerance


def _supports(
    on_plane: BoolArray,
    others: BoolArray,
    height: Float64Array,
    depth: NDArray[np.float32],
    frame: Frame,
) -> bool:
    """Whether a plane is a ground or a wall, not the flat side of a lone thing.

    It runs out of the picture, or something stands on it that is tall against its size.

    Args:
        on_plane: (H, W) the plane's pixels.
        others: (H, W) pixels that may stand on it.
        height: (H, W) distance in front of the plane, scene units.
        depth: (H, W) z-depth, scene units.
        frame: The picture.
    """
    border = np.concatenate([on_plane[0], on_plane[-1], on_plane[:, 0], on_plane[:, -1]])
    if border.mean() >= BORDER_SHARE:
        return True
    if others.sum() < BEHIND_SHARE * on_plane.sum():
        return False
    size = np.sqrt(on_plane.sum()) * np.median(depth[on_plane]) / frame.camera.K[0, 0]
    return bool(np.percentile(height[others], 90) >= TALL * size)


def _candidates(
    rays: Float64Array,
    depth: Float64Array,
    remaining: BoolArray,
    generator: np.random.Generator,
) -> tuple[Float64Array, Float64Array]:
    """Planes through triples of points that are near each other in the picture.

    Neighbours lie on one plane far more often than any three points do.

    Returns:
        Unit normals (t, 3), towards the camera's side, and offsets (t,): a point x lies
        normal @ x + offset in front of the plane.
    """
    height, width = depth.shape
    index = np.flatnonzero(remaining)
    base = index[generator.integers(len(index), size=_TRIALS)]
    reach = max(2, min(height, width) // 5)
    corners = [base]
    for _ in range(2):
        shift = generator.integers(-reach, reach + 1, size=(2, _TRIALS))
        y = np.clip(base // width + shift[0], 0, height - 1)
        x = np.clip(base % width + shift[1], 0, width - 1)
        corners.append(y * width + x)
    usable = remaining.reshape(-1)[corners[1]] & remaining.reshape(-1)[corners[2]]
    a, b, c = (
        rays.reshape(-1, 3)[corner[usable]] * depth.reshape(-1)[corner[usable], None]
        for corner in corners
    )
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    size = np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
    sound = length > 1e-2 * size
    normals, a = normals[sound] / length[sound, None], a[sound]
    offsets = -np.einsum("ij,ij->i", normals, a)
    side = np.where(offsets < 0, -1.0, 1.0)
    return normals * side[:, None], offsets * side


def _fit(points: Float64Array) -> tuple[Float64Array, float]:
    """The least-squares plane of points (n, 3), its normal towards the camera at the origin."""
    centre = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - centre, full_matrices=False)
    normal: Float64Array = axes[2]
    offset = -float(normal @ centre)
    return (-normal, -offset) if offset < 0 else (normal, offset)
