"""Whole things out of surfaces: regions whose gap in depth is small against their size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gvr_core.models.frame_geometry import FrameGeometry
from gvr_core.models.regions import LabelArray, dense_labels

GAP_PERCENTILE = 25.0
"""Of the depth steps along a common border: things that hang together do so in some places
only, as a leaf does at its stem."""


def merge_things(
    labels: LabelArray, geometry: FrameGeometry, focal: float, limit: float
) -> LabelArray:
    """Join neighbouring regions off the support planes that are near each other in depth.

    The cost of a pair is gap / sqrt(size_a size_b): the step in depth across the common border
    over the geometric mean of the regions' sizes, where a region's size is sqrt(pixels) times
    depth / focal length. All are lengths in units of the median depth. The cheapest pair is
    joined again and again until every pair costs more than the limit. So a leaf joins its plant,
    while two things as far apart as they are large do not join.

    Args:
        labels: (H, W) regions; none of them lies both on and off a support plane.
        geometry: Depth cues of the frame.
        focal: Focal length in pixels.
        limit: Highest cost of a pair that is joined.

    Returns:
        (H, W) labels; what is not shown, or lies on a support plane, keeps regions of its own.
    """
    off_plane = geometry.shown & (geometry.plane == 0) & (geometry.disparity > 0)
    dense = dense_labels(labels)
    depth = np.zeros(labels.shape)
    np.divide(1.0, geometry.disparity, out=depth, where=off_plane)
    count = int(dense.max()) + 1
    area = np.bincount(dense[off_plane], minlength=count).astype(float)
    total = np.bincount(dense[off_plane], depth[off_plane], minlength=count)
    size = total / np.maximum(area, 1) * np.sqrt(area) / focal
    return _join(_gaps(dense, depth, off_plane), size, limit)[dense]


def _gaps(
    dense: LabelArray, depth: NDArray[np.float64], off_plane: NDArray[np.bool_]
) -> dict[tuple[int, int], NDArray[np.float64]]:
    """Depth steps across the border of each pair of neighbouring regions (lower label first)."""
    pairs, steps = [], []
    for first, second in (
        (np.s_[:, :-1], np.s_[:, 1:]),
        (np.s_[:-1, :], np.s_[1:, :]),
    ):
        border = (dense[first] != dense[second]) & off_plane[first] & off_plane[second]
        pairs.append(np.sort(np.stack([dense[first][border], dense[second][border]], 1), axis=1))
        steps.append(np.abs(depth[first][border] - depth[second][border]))
    pair, step = np.concatenate(pairs), np.concatenate(steps)
    if len(pair) == 0:
        return {}
    order = np.lexsort((pair[:, 1], pair[:, 0]))
    pair, step = pair[order], step[order]
    starts = np.flatnonzero(np.r_[True, (np.diff(pair, axis=0) != 0).any(axis=1)])
    return {
        (int(pair[s, 0]), int(pair[s, 1])): part
        for s, part in zip(starts, np.split(step, starts[1:]), strict=True)
    }


def _join(
    gaps: dict[tuple[int, int], NDArray[np.float64]], size: NDArray[np.float64], limit: float
) -> LabelArray:
    """Which region each region ends up in, (count,)."""
    into = np.arange(len(size))
    steps, size = dict(gaps), size.copy()

    def cost(pair: tuple[int, int]) -> float:
        mean = np.sqrt(size[pair[0]] * size[pair[1]])
        return float(np.percentile(steps[pair], GAP_PERCENTILE) / mean)

    costs = {pair: cost(pair) for pair in steps}
    while costs:
        pair = min(costs, key=lambda p: (costs[p], p))
        if costs[pair] > limit:
            break
        kept, gone = pair
        into[into == gone] = kept
        size[kept] = np.hypot(size[kept], size[gone])
        del steps[pair], costs[pair]
        for old in [p for p in steps if gone in p]:
            other = old[0] if old[1] == gone else old[1]
            new = (min(kept, other), max(kept, other))
            steps[new] = np.concatenate([steps.get(new, steps[old][:0]), steps[old]])
            del steps[old], costs[old]
        for touched in [p for p in steps if kept in p]:
            costs[touched] = cost(touched)
    return into
