"""The up direction from the cameras and the ground plane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gvr_core.books import DepthBook
from gvr_core.cameras import unit, up_vector
from gvr_core.errors import CameraFormatError
from gvr_core.scene import View

Float64Array = NDArray[np.float64]

POINTS = 6000
"""Depth samples that planes are fitted to."""
HYPOTHESES = 800
"""Planes that are tried."""
THICKNESS = 0.01
"""A point belongs to a plane within this part of the median viewing distance."""
LEAST_SHARE = 0.15
"""A plane with a smaller share of all points is no ground."""
MOST_DEGREES = 45.0
"""A plane that leans further from the cameras' own up direction is a wall."""
BELOW_SHARE = 0.1
"""Beneath the ground there is nothing: of all points at most this share."""


def ground_up(views: Sequence[View], depths: DepthBook) -> Float64Array:
    """u: the normal of the ground plane, the side of it that the cameras call up.

    Cameras that look down from one side only have up axes that all lean the same way, and so
    has their mean. The plane that carries most of what they see, among those that do not lean
    too far from that mean and have nothing beneath them, says better what is up. RANSAC
    (Fischler and Bolles 1981) with a fixed seed, refined by least squares over its inliers.

    Args:
        views: The knowledge views.
        depths: B_d.

    Returns:
        (3,) unit vector; the cameras' mean up axis where there is no such plane.
    """
    prior = _cameras_up(views)
    points, distance = _depth_points(views, depths)
    if len(points) < 100:
        return prior
    points = points - np.median(points, axis=0)
    normal = _best_plane(points, prior, THICKNESS * distance)
    return prior if normal is None else normal


def _cameras_up(views: Sequence[View]) -> Float64Array:
    """The mean of the cameras' up axes; where they cancel out, against where they look.

    Cameras that look straight down, as drones do, hold their pictures any way round.
    """
    cameras = [view.camera for view in views]
    try:
        return up_vector(cameras).direction
    except CameraFormatError:
        return unit(-np.mean([camera.forward for camera in cameras], axis=0))


def _best_plane(points: Float64Array, prior: Float64Array, slack: float) -> Float64Array | None:
    rng = np.random.default_rng(0)
    corners = points[rng.integers(0, len(points), (HYPOTHESES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    sound = lengths > 1e-12 * float(np.abs(points).max()) ** 2
    normals = normals[sound] / lengths[sound, None]
    normals *= np.where(normals @ prior < 0, -1.0, 1.0)[:, None]
    upright = normals @ prior >= np.cos(np.radians(MOST_DEGREES))
    normals, origins = normals[upright], corners[sound][upright, 0]
    if len(normals) == 0:
        return None
    heights = points @ normals.T - np.einsum("hi,hi->h", origins, normals)
    on_plane = (np.abs(heights) <= slack).mean(axis=0)
    below = (heights < -3 * slack).mean(axis=0)
    on_plane[below > BELOW_SHARE] = 0.0
    best = int(np.argmax(on_plane))
    if on_plane[best] < LEAST_SHARE:
        return None
    carried = points[np.abs(heights[:, best]) <= slack]
    _, _, axes = np.linalg.svd(carried - carried.mean(axis=0), full_matrices=False)
    normal: Float64Array = axes[2] if axes[2] @ prior > 0 else -axes[2]
    return unit(normal)


def _depth_points(views: Sequence[View], depths: DepthBook) -> tuple[Float64Array, float]:
    """Points of the views' surfaces (p, 3) on a regular grid of pixels, and how far they are."""
    each = max(16, POINTS // max(1, len(views)))
    points, distances = [], []
    for i, view in enumerate(views):
        depth = depths.depth(i, "median")
        step = max(1, int(np.sqrt(depth.size / each)))
        rows, columns = np.mgrid[
            step // 2 : depth.shape[0] : step, step // 2 : depth.shape[1] : step
        ]
        z = depth[rows, columns].ravel().astype(np.float64)
        xy = np.stack([columns.ravel(), rows.ravel()], axis=1)[z > 0] + 0.5
        points.append(view.camera.unproject(xy, z[z > 0]))
        distances.append(z[z > 0])
    together = np.concatenate(distances)
    return np.concatenate(points), float(np.median(together)) if len(together) else 0.0
