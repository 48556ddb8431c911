"""The row of 16 numbers, a cache line long, that the stages pass on for each projected Gaussian.

Projection and colour fill the row, binning and blending read it. With d = (dx, dy) the offset
of a pixel centre from the projected mean, and the projected covariance [[xx, xy], [xy, yy]],

    d^T Sigma^-1 d = (dx - k dy)^2 / s + dy^2 / yy,    k = xy / yy,    s = det / yy.

A long thin Gaussian has entries of Sigma^-1 that cancel to a thousandth and less; in this form
nothing cancels, so that float32 is enough, and a row of pixels costs one multiply-add each for
the bracket and its square. The exponent is kept in base 2 and divided by 8:

    alpha = 2^(8 t),    t = log2(opacity) / 8 - (A dx - B dy)^2 - (C dy)^2.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gvr_core.rendering.base import ALPHA_MIN

TILE = 16
"""Side of a tile, pixels."""

ROW = 16
"""Numbers per Gaussian."""

MEAN_X, MEAN_Y = 0, 1
"""Projected mean, pixels."""
A, B, C = 2, 3, 4
"""Factors of the exponent, 1/pixel: A = kappa / sqrt(s), B = k A, C = kappa / sqrt(yy)."""
T0 = 5
"""log2(opacity) / 8: the exponent at the mean."""
RED, GREEN, BLUE = 6, 7, 8
"""Colour seen from the camera, >= 0."""
DEPTH = 9
"""z in the camera frame, scene units."""
EXTENT_Y = 10
"""Half height, pixels, of the ellipse on which alpha is 1/255."""
RIGHTMOST_Y = 11
"""dy of the rightmost point of that ellipse; -dy of the leftmost."""
COLUMN = 12
"""1 / (B^2 + C^2): the ellipse meets a column of pixels, dx away from the mean, where
dy = (A B dx +- sqrt((T0 - T_MIN) / COLUMN - (A C dx)^2)) COLUMN."""
HIGHEST_X = 13
"""dx of the highest point of that ellipse; -dx of the lowest."""
REST_X, REST_Y = 14, 15
"""What float32 leaves out of the projected mean, pixels. At x = 640 that is up to 3e-5, and a
Gaussian of a pixel's size gains or loses as much opacity by it."""

EXPONENT_SCALE = math.sqrt(math.log2(math.e) / 16)
"""kappa: makes the squares add up to the exponent in base 2, divided by 8."""

T_MIN = np.float32(math.log2(ALPHA_MIN) / 8)
"""The exponent at which alpha is 1/255."""


class Window(NamedTuple):
    """A rectangle of tiles."""

    columns: tuple[int, int]
    """First column of tiles, and one past the last."""
    rows: tuple[int, int]
    """First row of tiles, and one past the last."""


def empty_rows(n: int) -> NDArray[np.float32]:
    """(n, 16) float32, not initialised, each row on a cache line of its own."""
    room = np.empty((n + 1) * ROW, np.float32)
    skip = (-room.ctypes.data // room.itemsize) % ROW
    return room[skip : skip + n * ROW].reshape(n, ROW)
