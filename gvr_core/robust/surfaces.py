"""What a patch shows: the pixels of its surface, and the middle and radius of their points.

Candidates come by the hundred, and each is a few hundred pixels: what numpy would spend on
calling its functions is more than the work itself.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gvr_core.rendering.compiled import precise_kernel

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float32]
Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]


@precise_kernel
def inner_depths(pixels: BoolArray, inner: BoolArray, depth: FloatArray) -> FloatArray:
    """Depths of a patch's inner part; of all of it where that has none.

    Args:
        pixels: (h, w) the patch.
        inner: (h, w) the patch without its outline.
        depth: (h, w) float32, 0 where nothing is.

    Returns:
        (d,) float32 above 0, row by row; none where the patch has no depth.
    """
    height, width = pixels.shape
    everywhere, area = np.empty(pixels.size, np.float32), 0
    core, found = np.empty(pixels.size, np.float32), 0
    for y in range(height):
        for x in range(width):
            if pixels[y, x] and depth[y, x] > 0:
                everywhere[area] = depth[y, x]
                area += 1
                if inner[y, x]:
                    core[found] = depth[y, x]
                    found += 1
    return core[:found] if found > 0 else everywhere[:area]


@precise_kernel
def pixels_near(
    pixels: BoolArray, depth: FloatArray, middle: np.float32, limit: np.float32, most: int
) -> Int64Array:
    """Pixels of a patch whose depth is near a depth, evenly thinned out.

    Args:
        pixels: (h, w) the patch.
        depth: (h, w) float32, 0 where nothing is.
        middle: The depth.
        limit: Largest difference from it.
        most: Pixels kept, 2 or more.

    Returns:
        (s, 2) rows and columns, row by row, s <= most.
    """
    height, width = pixels.shape
    found, count = np.empty((pixels.size, 2), np.int64), 0
    for y in range(height):
        for x in range(width):
            if pixels[y, x] and depth[y, x] > 0 and abs(depth[y, x] - middle) <= limit:
                found[count, 0], found[count, 1] = y, x
                count += 1
    if count <= most:
        return found[:count]
    kept = np.empty((most, 2), np.int64)
    step = (count - 1) / (most - 1)
    for n in range(most):
        place = count - 1 if n == most - 1 else int(n * step)
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
        ordered = np.sort(points[:, axis].copy())
        half = ordered.size // 2
        middle = ordered[half] if ordered.size % 2 == 1 else (ordered[half - 1] + ordered[half]) / 2
        centre[axis] = middle
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
