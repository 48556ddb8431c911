"""What both walks over a tile's Gaussians do alike: pictures, and weights under masks.

The kernels of :mod:`~gvr_core.rendering.blending` and :mod:`~gvr_core.rendering.weighing` have
these put in place of each call, so this file is part of what their compiled code is cached under.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gvr_core.rendering.base import ALPHA_MAX, TRANSMITTANCE_MIN
from gvr_core.rendering.compiled import inlined
from gvr_core.rendering.layout import (
    COLUMN,
    HIGHEST_X,
    MEAN_X,
    MEAN_Y,
    REST_X,
    REST_Y,
    ROW,
    T0,
    T_MIN,
    TILE,
    A,
    B,
    C,
)

FloatArray = NDArray[np.float32]
IntArray = NDArray[np.int32]

ZERO, HALF, ONE = np.float32(0), np.float32(0.5), np.float32(1)
HIGHEST_ALPHA, STOP = np.float32(ALPHA_MAX), np.float32(TRANSMITTANCE_MIN)
BATCH = 32
"""Gaussians between two looks at which rows of a tile are finished."""

_CACHE_LINE = 16
"""In numbers of four bytes."""
_LAST = np.float32(TILE - 1)
_SLACK = np.float32(1e-3)
"""Pixels; keeps rounding of the covered lines from taking the decision on alpha."""

# 2^t on [-1, 0]: the polynomial of degree 5 with the least relative error, 7.5e-8.
_P0, _P1 = np.float32(0.9999999250634852), np.float32(0.6931422525915856)
_P2, _P3 = np.float32(0.24017218923634062), np.float32(0.05527972254849632)
_P4, _P5 = np.float32(0.00918861169470596), np.float32(0.0009387883226651354)


@inlined
def aligned(n: int) -> FloatArray:
    """(n,) float32 from the start of a cache line: a vector across two lines costs double."""
    room = np.empty(n + _CACHE_LINE, np.float32)
    skip = (-room.ctypes.data // 4) % _CACHE_LINE
    return room[skip : skip + n]


@inlined
def living_lines(state: FloatArray) -> tuple[int, int]:
    """First and last row of the tile that is still being blended; (16, -1) if none is.

    Args:
        state: (16, S) float32; the first 16 of each row are T, negative where it is done.
    """
    first, last = TILE, -1
    for y in range(TILE):
        line, living = state[y], np.int32(0)
        for x in range(TILE):
            living += np.int32(line[x] > ZERO)
        if living > 0:
            first, last = min(first, y), y
    return first, last


@inlined
def _covered_lines(
    row: FloatArray, left: np.float32, right: np.float32
) -> tuple[np.float32, np.float32]:
    """Lowest and highest dy at which the ellipse alpha = 1/255 has dx in [left, right]."""
    a, b, c, column = row[A], row[B], row[C], row[COLUMN]
    ab, ac, most = a * b, a * c, (row[T0] - T_MIN) * (b * b + c * c)
    x = min(max(row[HIGHEST_X], left), right)
    high = (ab * x + math.sqrt(max(most - (ac * x) * (ac * x), ZERO))) * column
    x = min(max(-row[HIGHEST_X], left), right)
    low = (ab * x - math.sqrt(max(most - (ac * x) * (ac * x), ZERO))) * column
    return low - _SLACK, high + _SLACK


@inlined
def fetch(
    rows: FloatArray,
    pairs: IntArray,
    start: int,
    size: int,
    left_centre: np.float32,
    top_centre: np.float32,
    batch: FloatArray,
    lines_of: IntArray,
) -> None:
    """Bring the next Gaussians of a tile into the cache, in coordinates of the tile.

    The processor guesses wrong how many lines each one covers, which costs little where the
    numbers are known long before they are needed.
    """
    for n in range(size):
        i = pairs[start + n]
        for k in range(ROW):
            batch[n, k] = rows[i, k]
        mean_x = (batch[n, MEAN_X] - left_centre) + batch[n, REST_X]
        mean_y = (batch[n, MEAN_Y] - top_centre) + batch[n, REST_Y]
        low, high = _covered_lines(batch[n], -mean_x, _LAST - mean_x)
        lines_of[n, 0] = np.int32(max(np.ceil(mean_y + low), ZERO))
        lines_of[n, 1] = np.int32(max(min(np.floor(mean_y + high), _LAST), -ONE))
        batch[n, MEAN_X], batch[n, MEAN_Y] = -batch[n, A] * mean_x, mean_y


@inlined
def power_of_two(t: np.float32) -> np.float32:
    """2^(8 t) for t in [-1, 0], without a branch."""
    s = max(t, -ONE)
    power = _P0 + s * (_P1 + s * (_P2 + s * (_P3 + s * (_P4 + s * _P5))))
    power *= power
    power *= power
    power *= power
    return power
