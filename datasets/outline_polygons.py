"""Polygons that draw a mask exactly, for layouts that hold outlines instead of pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

PolygonArray = NDArray[np.float64]

_INSET = np.array([[0.25, 0.25], [0.75, 0.25], [0.75, 0.75], [0.25, 0.75]])
"""Added to the four corners of a run of pixels: cut to whole numbers they are the run again, and
the polygon has an area even where the run is a single pixel."""


def outline_polygons(mask: NDArray[np.bool_]) -> tuple[PolygonArray, ...]:
    """Polygons whose union, drawn as `datasets.polygons.PolygonMask` draws, is the mask.

    OpenCV's filling colours the outline as well as what it encloses, so a connected part without
    holes is the filling of its own border pixels. A part with holes is cut along a row through
    one of them, which opens the hole towards the cut, until no part has any; so is a line that
    is thin and bent, until it is straight, since its border would enclose nothing.

    Args:
        mask: (H, W) bool.

    Returns:
        One polygon (k, 2) of corners x, y for each part, k >= 3, each with an area, in the order
        in which the parts are met from the top; none for an empty mask.
    """
    polygons: list[PolygonArray] = []
    # a stack, not recursion: a mask like a sieve takes one cut for every row
    waiting = [(np.ascontiguousarray(mask, np.uint8), 0, 0)]
    while waiting:
        piece, left, top = waiting.pop()
        for part, x, y in _parts(piece):
            polygon, cut = _border(part)
            if cut is None:
                polygons.append(polygon + np.array([left + x, top + y], np.float64))
            else:
                waiting.append((part[:cut], left + x, top + y))
                waiting.append((part[cut:], left + x, top + y + cut))
    return tuple(sorted(polygons, key=lambda corners: (corners[:, 1].min(), corners[:, 0].min())))


def polygon_area(polygon: PolygonArray) -> float:
    """What a polygon (k, 2) encloses, by the shoelace formula."""
    x, y = (polygon - polygon[0]).T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def _parts(piece: NDArray[np.uint8]) -> list[tuple[NDArray[np.uint8], int, int]]:
    """The 8-connected parts of a piece, each cut out, with its left and top."""
    import cv2

    count, labels, stats, _ = cv2.connectedComponentsWithStats(piece, connectivity=8)
    parts = []
    for label in range(1, count):
        x, y, width, height = (int(number) for number in stats[label, :4])
        part = labels[y : y + height, x : x + width] == label
        parts.append((part.astype(np.uint8), x, y))
    return parts


def _border(part: NDArray[np.uint8]) -> tuple[PolygonArray, int | None]:
    """The polygon of one connected part; or the row before which it has to be cut first."""
    import cv2

    height, width = part.shape
    if height == 1 or width == 1:
        corners = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]])
        return corners + _INSET, None
    contours, _ = cv2.findContours(part, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    border = contours[0].reshape(-1, 2)
    if polygon_area(border.astype(np.float64)) == 0:
        return border.astype(np.float64), height // 2
    filled = np.zeros(part.shape, np.uint8)
    cv2.fillPoly(filled, [border.astype(np.int32)], (1,))
    holes = np.flatnonzero((filled > part).any(axis=1))
    # a hole never reaches the last row: both halves have rows
    return border.astype(np.float64), int(holes[len(holes) // 2]) + 1 if holes.size else None
