"""What a patch shows: the pixels of its surface, and the middle and radius of their points.

Candidates come by the hundred, and each is a few hundred pixels: what numpy would spend on
calling its functions is more than the work itself.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gvr_core.rendering.compiled import inlined, precise_kernel

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float32]
Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]


@inlined
def _middle(ordered: FloatArray | Float64Array) -> Any:
    """Median of sorted numbers, as numpy's: of two middle ones the mean, in their own precision."""
    half = ordered.size // 2
    if ordered.size % 2 == 1:
        return ordered[half]
    total = ordered[half - 1] + ordered[half]
    return total * ordered.dtype.type(0.5)


@precise_kernel
def surface_pixels(
    pixels: BoolArray,
    inner: BoolArray,
    depth: FloatArray,
    mad_limit: float,
    slack: float,
    most: int,
) -> Int64Array:
    """Pixels of a patch whose depth is near the median of its inner part, evenly thinned out.

    Args:
        pixels: (h, w) the patch.
        inner: (h, w) the patch without its outline; where it has no depth, all of it counts.
        depth: (h, w) float32, 0 where nothing is.
        mad_limit: Depths further from the median than so many (scaled) median deviations are left
            out,
        slack: but not those within this fraction of it.
        most: Pixels kept.

    Returns:
        (s, 2) rows and columns, s <= most; none where the patch has no depth.
    """
    height, width = pixels.shape
    area, core = 0, 0
    known, values = np.empty(pixels.size, np.float32), np.empty(pixels.size, np.float32)
    for y in range(height):
        for x in range(width):
            if pixels[y, x] and depth[y, x] > 0:
                known[area] = depth[y, x]
                area += 1
                if inner[y, x]:
                    values[core] = depth[y, x]
                    core += 1
    if area == 0:
        return np.empty((0, 2), np.int64)
    if core == 0:
        values, core = known, area
    middle = _middle(np.sort(values[:core]))
    deviations = np.abs(values[:core] - middle)
    limit = max(mad_limit * (1.4826 * np.float64(_middle(np.sort(deviations)))), slack * middle)
    # As numpy does where it compares float32 with a number: in float32.
    near = np.float32(limit)
    found = np.empty((area, 2), np.int64)
    count = 0
    for y in range(height):
        for x in range(width):
            if pixels[y, x] and depth[y, x] > 0 and np.abs(depth[y, x] - middle) <= near:
                found[count, 0], found[count, 1] = y, x
                count += 1
    if count <= most:
        return found[:count]
    kept = np.empty((most, 2), np.int64)
    step = (count - 1) / (most - 1)
    for n in range(most):
        place = count - 1 if n == most - 1 else np.int64(n * step)
        kept[n] = found[place]
    return kept


@precise_kernel
def middle_of(points: Float64Array, percentile: float) -> tuple[int, float]:
    """The point nearest to the median of all, and how far the others reach from the median.

    Args:
        points: (s, 3), s >= 1.
        percentile: Of the distances, in per cent, interpolated as numpy does.

    Returns:
        Index of the point, and the distance.
    """
    centre, distances = np.empty(3), np.empty(len(points))
    nearest: int = 0
    for axis in range(3):
        centre[axis] = _middle(np.sort(points[:, axis].copy()))
    for i in range(len(points)):
        x, y, z = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
        distances[i] = math.sqrt(x * x + y * y + z * z)
        if distances[i] < distances[nearest]:
            nearest = i
    ordered = np.sort(distances)
    place = percentile / 100 * (ordered.size - 1)
    below = int(place)
    above = min(below + 1, ordered.size - 1)
    part, gap = place - below, ordered[above] - ordered[below]
    reach = ordered[above] - gap * (1 - part) if part >= 0.5 else ordered[below] + gap * part
    return nearest, reach
