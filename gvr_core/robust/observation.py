"""How well the cameras have seen what a bird's-eye view shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gvr_core.books import DepthBook
from gvr_core.models.base import Frame
from gvr_core.scene import Scene

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
    seen = np.zeros(len(points), np.int64)
    for i, view in enumerate(scene.views):
        camera = view.camera
        towards = points - camera.position
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        pixels, z = camera.project(points)
        inside = (z > 0) & (np.einsum("pi,pi->p", towards, down) >= least)
        with np.errstate(invalid="ignore"):
            inside &= (pixels[:, 0] >= 0) & (pixels[:, 0] < camera.width)
            inside &= (pixels[:, 1] >= 0) & (pixels[:, 1] < camera.height)
        at = np.floor(pixels[inside]).astype(np.int64)
        depth = depths.depth(i, "median")[at[:, 1], at[:, 0]]
        seen[inside] += (depth > 0) & (depth >= (1 - DEPTH_SLACK) * z[inside])
    return float((seen >= LEAST_VIEWS).mean())
