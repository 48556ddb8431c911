"""Whole things out of surfaces: regions whose gap in depth is small against their size."""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

from gvr_core.models.frame_geometry import FrameGeometry
from gvr_core.models.regions import LabelArray

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
    _, dense = np.unique(labels, return_inverse=True)
    dense = dense.reshape(labels.shape).astype(np.int64)
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
    size = size.copy()
    neighbours: dict[int, dict[int, NDArray[np.float64]]] = {}
    queue: list[tuple[float, int, int, int]] = []

    def offer(a: int, b: int) -> None:
        a, b = min(a, b), max(a, b)
        steps = neighbours[a][b]
        cost = float(np.percentile(steps, GAP_PERCENTILE) / np.sqrt(size[a] * size[b]))
        if cost <= limit:
            heapq.heappush(queue, (cost, a, b, len(steps)))

    for (a, b), steps in gaps.items():
        neighbours.setdefault(a, {})[b] = steps
        neighbours.setdefault(b, {})[a] = steps
    for a, b in gaps:
        offer(a, b)
    alive = dict.fromkeys(neighbours, 0)
    version: dict[int, float] = {a: size[a] for a in alive}
    while queue:
        cost, a, b, n = heapq.heappop(queue)
        if a not in alive or b not in alive or b not in neighbours[a]:
            continue
        steps = neighbours[a][b]
        now = float(np.percentile(steps, GAP_PERCENTILE) / np.sqrt(size[a] * size[b]))
        if len(steps) != n or now != cost:
            continue  # an older offer; the present one is in the queue as well
        into[into == b] = a
        size[a] = float(np.hypot(size[a], size[b]))
        version[a] = size[a]
        del alive[b], neighbours[a][b]
        for other, border in neighbours.pop(b).items():
            if other == a:
                continue
            del neighbours[other][b]
            joined = np.concatenate([neighbours[a].get(other, border[:0]), border])
            neighbours[a][other] = neighbours[other][a] = joined
        for other in neighbours[a]:
            offer(a, other)
    return into
