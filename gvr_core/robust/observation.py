"""How well the cameras have seen what a bird's-eye view shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gvr_core.books import DepthBook
from gvr_core.models.base import Frame
from gvr_core.rendering.compiled import precise_kernel
from gvr_core.scene import Scene

Float64Array = NDArray[np.float64]

POINTS = 400
"""Points of the mask that are looked up in the views."""
DEPTH_SLACK = 0.03
"""A point is seen by a view whose depth there is at most this part smaller than the point's."""
LEAST_VIEWS = 2
"""So many cameras must have seen a point."""


def observed_share(
    scene: Scene,
    depths: DepthBook,
    bev: Frame,
    mask: NDArray[np.bool_],
    most_degrees: float,
) -> float:
    """Part of a bird's-eye mask that two cameras or more have seen from nearly above.

    What no camera has seen from above is whatever training left there; a mask cut from its
    picture means nothing.

    Args:
        scene: The scene.
        depths: B_d.
        bev: The bird's-eye view.
        mask: (H, W) its mask.
        most_degrees: Such a camera looks at the point along a direction that is at most so far
            from the bird's-eye camera's.

    Returns:
        In [0, 1]; 0 for an empty mask.
    """
    rows, columns = np.nonzero(mask & (bev.depth > 0))
    if len(rows) == 0:
        return 0.0
    kept = np.linspace(0, len(rows) - 1, min(POINTS, len(rows))).astype(np.int64)
    rows, columns = rows[kept], columns[kept]
    xy = np.stack([columns, rows], axis=1) + 0.5
    points = bev.camera.unproject(xy, bev.depth[rows, columns])
    down = points - bev.camera.position
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    least = np.cos(np.radians(most_degrees))
    eyes = np.stack([view.camera.position for view in scene.views])
    poses = np.stack([view.camera.world_to_camera for view in scene.views])
    lenses = np.stack([view.camera.K for view in scene.views])
    sizes = np.array([(view.camera.height, view.camera.width) for view in scene.views])
    rows = np.empty((len(eyes), len(points)), np.int64)
    columns, depth = np.empty_like(rows), np.empty(rows.shape)
    _look_up(points, down, eyes, poses, lenses, sizes, float(least), rows, columns, depth)
    seen = np.zeros(len(points), np.int64)
    for i in np.flatnonzero((rows >= 0).any(axis=1)):
        inside = np.flatnonzero(rows[i] >= 0)
        found = depths.depth(int(i), "median")[rows[i, inside], columns[i, inside]]
        seen[inside] += (found > 0) & (found >= (1 - DEPTH_SLACK) * depth[i, inside])
    return float((seen >= LEAST_VIEWS).mean())


@precise_kernel
def _look_up(
    points: Float64Array,
    down: Float64Array,
    eyes: Float64Array,
    poses: Float64Array,
    lenses: Float64Array,
    sizes: NDArray[np.int64],
    least: float,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    depth: Float64Array,
) -> None:
    """Where points fall in views that look at them along nearly the same direction.

    Args:
        points: (p, 3), world frame.
        down: (p, 3) unit directions from the bird's-eye camera to them.
        eyes: (n, 3) camera centres.
        poses: (n, 4, 4) world to camera.
        lenses: (n, 3, 3) intrinsics.
        sizes: (n, 2) height and width.
        least: Least cosine between the two directions.
        rows: (n, p), written: the pixel's row, -1 where the view does not count.
        columns: (n, p), written where it does: its column.
        depth: (n, p), written where it does: z, scene units.
    """
    for i in range(eyes.shape[0]):
        pose, lens = poses[i], lenses[i]
        for p in range(points.shape[0]):
            rows[i, p] = -1
            x, y, z = points[p, 0], points[p, 1], points[p, 2]
            dx, dy, dz = x - eyes[i, 0], y - eyes[i, 1], z - eyes[i, 2]
            along = dx * down[p, 0] + dy * down[p, 1] + dz * down[p, 2]
            away = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
            if not (away > 0 and along >= least * np.sqrt(dx * dx + dy * dy + dz * dz)):
                continue
            across = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
            below = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
            column = np.floor(across / away * lens[0, 0] + lens[0, 2])
            row = np.floor(below / away * lens[1, 1] + lens[1, 2])
            if 0 <= column < sizes[i, 1] and 0 <= row < sizes[i, 0]:
                rows[i, p], columns[i, p] = np.int64(row), np.int64(column)
                depth[i, p] = away
