"""Which Gaussians touch which 16 x 16 tile, front to back: exact for pixel centres.

For each row of tiles, the columns that the ellipse alpha = 1/255 covers are those between its
leftmost and its rightmost point within the band of that row's pixel centres. The pairs are then
put in order of tiles by a counting sort that keeps the order of depth.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gvr_core.rendering.compiled import inlined, kernel
from gvr_core.rendering.layout import (
    EXTENT_Y,
    MEAN_X,
    MEAN_Y,
    RIGHTMOST_Y,
    T0,
    T_MIN,
    TILE,
    A,
    B,
    C,
)

FloatArray = NDArray[np.float32]
IntArray = NDArray[np.int32]

_ZERO, _ONE, _HALF = np.float32(0), np.float32(1), np.float32(0.5)
_TILE, _LAST = np.float32(TILE), np.float32(TILE - 0.5)
_SLACK = np.float32(1e-3)
"""Pixels; keeps rounding here from taking a decision that belongs to blending."""


@inlined
def _clamped_tile(coordinate: np.float32, tiles: int) -> int:
    """Tile that a pixel coordinate lies in, or the nearest one, -1 or ``tiles`` outside."""
    position = np.floor(coordinate / _TILE)
    return int(min(max(position, np.float32(-1)), np.float32(tiles)))


@kernel
def bin_piece(
    start: int,
    stop: int,
    rows: FloatArray,
    tiles_x: int,
    first_column: int,
    end_column: int,
    first_line: int,
    end_line: int,
    cursor: NDArray[np.int64],
    pairs: IntArray,
    emit: bool,
) -> None:
    """Count the pairs of each tile for one piece of the depth order, or write them down.

    Args:
        start: First Gaussian.
        stop: One past the last.
        rows: (n, 16) float32, front to back.
        tiles_x: Tiles in a row of the picture.
        first_column: First column of tiles that is drawn.
        end_column: One past the last.
        first_line: First row of tiles that is drawn.
        end_line: One past the last.
        cursor: (tiles,) int64; counts up, or holds where this piece's next pair belongs.
        pairs: (P,) int32, written where ``emit``.
        emit: False counts, True writes.
    """
    for i in range(start, stop):
        row = rows[i]
        mean_x, mean_y = row[MEAN_X], row[MEAN_Y]
        extent_y, limit = row[EXTENT_Y] + _SLACK, row[T0] - T_MIN
        a, b, c = row[A], row[B], row[C]
        width = _ONE / a
        slant = b * width
        rightmost_y = row[RIGHTMOST_Y]
        top, bottom = np.ceil(mean_y - extent_y - _HALF), np.floor(mean_y + extent_y - _HALF)
        first_row = max(_clamped_tile(top, end_line), first_line)
        last_row = min(_clamped_tile(bottom, end_line), end_line - 1)
        for tile_y in range(first_row, last_row + 1):
            low = np.float32(tile_y * TILE) + _HALF - mean_y
            high = np.float32(tile_y * TILE) + _LAST - mean_y
            right_y = min(max(rightmost_y, low), high)
            left_y = min(max(-rightmost_y, low), high)
            right_v, left_v = c * right_y, c * left_y
            right = (
                mean_x + slant * right_y + width * math.sqrt(max(limit - right_v * right_v, _ZERO))
            )
            left = mean_x + slant * left_y - width * math.sqrt(max(limit - left_v * left_v, _ZERO))
            # From edges in pixels to the columns whose centres lie between them.
            leftmost = np.ceil(max(left - _SLACK - _HALF, -_ONE))
            rightmost = np.floor(right + _SLACK - _HALF)
            if not leftmost <= rightmost:
                continue
            first_tile = max(_clamped_tile(leftmost, end_column), first_column)
            last_tile = min(_clamped_tile(rightmost, end_column), end_column - 1)
            for tile in range(tile_y * tiles_x + first_tile, tile_y * tiles_x + last_tile + 1):
                place = cursor[tile]
                if emit:
                    pairs[place] = i
                cursor[tile] = place + 1


@kernel
def cursors(counts: NDArray[np.int64], first_pair: NDArray[np.int64]) -> None:
    """Turn counts into places: for each tile in turn, its pieces one after another.

    Args:
        counts: (pieces, tiles) int64; replaced by where each piece's first pair belongs.
        first_pair: (tiles + 1,) int64, written: where each tile's pairs begin.
    """
    pieces, tiles = counts.shape
    position = np.int64(0)
    for tile in range(tiles):
        first_pair[tile] = position
        for piece in range(pieces):
            count = counts[piece, tile]
            counts[piece, tile] = position
            position += count
    first_pair[tiles] = position
