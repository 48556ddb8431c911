"""Gaussians that spoil virtual views: invisible, huge, or hanging alone in the air."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from gvr_core.gaussians import Gaussians

LEAST_OPACITY = 0.05
"""Fainter Gaussians are nearly invisible."""
NEIGHBOURS = 8
"""A Gaussian of a surface has so many others near it."""
ALONE = 3.0
"""One that does not reach so many within this many of its own standard deviations is alone."""
HUGE = 20.0
"""One whose standard deviation is this many distances to them covers things it is no part of."""


def steady(gaussians: Gaussians) -> NDArray[np.bool_]:
    """Which Gaussians may be drawn in a virtual view.

    Virtual cameras stand where no photograph was taken, and look through what training has left
    hanging in the air. Nothing is deleted: the flags only say what to draw.

    Args:
        gaussians: The scene G.

    Returns:
        (N,) True for the Gaussians to draw; all True where hardly any would be left.
    """
    size = gaussians.scales.max(axis=1)
    kept = gaussians.opacities >= LEAST_OPACITY
    if np.count_nonzero(kept) > NEIGHBOURS:
        means = gaussians.means[kept]
        distances = KDTree(means).query(means, k=NEIGHBOURS + 1, workers=-1)[0][:, -1]
        kept[kept] = (distances <= ALONE * size[kept]) & (size[kept] <= HUGE * distances)
    return kept if kept.mean() >= 0.2 else np.ones(len(gaussians), np.bool_)
