"""Front-to-back blending of a tile's Gaussians, sixteen pixels of a row at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gvr_core.rendering.compiled import inlined, kernel, prefer_wide_vectors, prefetch_row
from gvr_core.rendering.layout import (
    BLUE,
    DEPTH,
    GREEN,
    MEAN_X,
    MEAN_Y,
    RED,
    ROW,
    T0,
    T_MIN,
    TILE,
    A,
    B,
    C,
)
from gvr_core.rendering.tile_rows import (
    BATCH,
    HALF,
    HIGHEST_ALPHA,
    ONE,
    STOP,
    ZERO,
    aligned,
    fetch,
    living_lines,
    power_of_two,
)

FloatArray = NDArray[np.float32]
IntArray = NDArray[np.int32]

# What is kept of a row of sixteen pixels: T (negative once blending has stopped there), the sums
# of colour and depth, and the median depth.
_T, _R, _G, _B, _D, _MEDIAN = 0, TILE, 2 * TILE, 3 * TILE, 4 * TILE, 5 * TILE
STATE = 6 * TILE
"""Numbers kept of a row of pixels."""


@inlined
def blend_row(
    state: FloatArray,
    u_left: np.float32,
    a: np.float32,
    t_row: np.float32,
    red: np.float32,
    green: np.float32,
    blue: np.float32,
    depth: np.float32,
    mask: FloatArray | None,
    sums: FloatArray | None,
) -> None:
    """Blend one Gaussian into sixteen pixels of a row: float32 and without branches.

    Args:
        state: (96,) float32, the row of pixels. One array, in which LLVM can see that the parts
            do not overlap: else it would not use vectors.
        u_left: A dx - B dy in the leftmost pixel.
        a: A, what that grows by from pixel to pixel.
        t_row: log2(opacity) / 8 - (C dy)^2.
        red: Colour of the Gaussian, as the next two.
        green: See ``red``.
        blue: See ``red``.
        depth: z of the Gaussian.
        mask: (32,) float32, the mask in these pixels and 1 - mask, or None.
        sums: (32,) float32, where the weights times those are added up, or None.
    """
    prefer_wide_vectors()
    for x in range(TILE):
        u = u_left + a * np.float32(x)
        t = t_row - u * u
        alpha = min(power_of_two(t), HIGHEST_ALPHA)
        before = state[_T + x]
        after = before - alpha * before
        hit = t >= T_MIN
        goes_on = hit & (after > STOP)
        left = after if goes_on else before
        weight = before - left
        stopped = -abs(before) if hit else before
        state[_T + x] = after if goes_on else stopped
        state[_R + x] += weight * red
        state[_G + x] += weight * green
        state[_B + x] += weight * blue
        state[_D + x] += weight * depth
        median = state[_MEDIAN + x]
        state[_MEDIAN + x] = depth if (before > HALF) & (left <= HALF) else median
        if mask is not None and sums is not None:
            sums[x] += weight * mask[x]
            sums[TILE + x] += weight * mask[TILE + x]


@kernel
def blend_tiles(
    start: int,
    stop: int,
    first_pair: NDArray[np.int64],
    pairs: IntArray,
    rows: FloatArray,
    tiles_x: int,
    background: FloatArray,
    rgb: FloatArray,
    alpha: FloatArray,
    expected_depth: FloatArray,
    median_depth: FloatArray,
    mask: FloatArray | None,
    inside: FloatArray | None,
    outside: FloatArray | None,
) -> None:
    """Draw the tiles ``start`` to ``stop`` - 1.

    Args:
        start: First tile.
        stop: One past the last.
        first_pair: (tiles + 1,) int64: where each tile's pairs begin.
        pairs: (P,) int32: Gaussians of each tile, front to back.
        rows: (N, 16) float32, see :mod:`gvr_core.rendering.layout`.
        tiles_x: Tiles in a row.
        background: (3,) float32.
        rgb: (H, W, 3) float32, written.
        alpha: (H, W) float32, written.
        expected_depth: (H, W) float32, written.
        median_depth: (H, W) float32, written.
        mask: (H, W) float32 or None.
        inside: (P,) float32, written where there is a mask: the sum of mask * alpha T of each
            pair. Zero for pairs that are never reached.
        outside: (P,) float32, likewise of (1 - mask) * alpha T.
    """
    height, width = alpha.shape
    state = aligned(TILE * STATE).reshape((TILE, STATE))
    batch, lines_of = np.empty((BATCH, ROW), np.float32), np.empty((BATCH, 2), np.int32)
    if mask is not None:
        tile_mask = np.zeros((TILE, 2 * TILE), np.float32)
        sums = np.empty(2 * TILE, np.float32)
    for tile in range(start, stop):
        left, top = (tile % tiles_x) * TILE, (tile // tiles_x) * TILE
        columns, lines = min(TILE, width - left), min(TILE, height - top)
        state[:, :] = ZERO
        for y in range(TILE):
            for x in range(TILE):
                state[y, _T + x] = ONE if (y < lines and x < columns) else -ONE
        if mask is not None:
            for y in range(lines):
                for x in range(columns):
                    tile_mask[y, x] = mask[top + y, left + x]
                    tile_mask[y, TILE + x] = ONE - mask[top + y, left + x]
        left_centre, top_centre = np.float32(left) + HALF, np.float32(top) + HALF
        begin, end = first_pair[tile], first_pair[tile + 1]
        for first_of_batch in range(begin, end, BATCH):
            top_line, bottom_line = living_lines(state)
            if top_line > bottom_line:
                break
            size = min(BATCH, end - first_of_batch)
            fetch(rows, pairs, first_of_batch, size, left_centre, top_centre, batch, lines_of)
            for pair in range(first_of_batch + size, min(first_of_batch + size + BATCH, end)):
                prefetch_row(rows, pairs[pair])
            for n in range(size):
                row = batch[n]
                mean_y, u_left = row[MEAN_Y], row[MEAN_X]
                a, b, c, t0 = row[A], row[B], row[C], row[T0]
                red, green, blue, depth = row[RED], row[GREEN], row[BLUE], row[DEPTH]
                if mask is not None:
                    sums[:] = ZERO
                for y in range(max(lines_of[n, 0], top_line), min(lines_of[n, 1], bottom_line) + 1):
                    dy = np.float32(y) - mean_y
                    v = c * dy
                    u, t = u_left - b * dy, t0 - v * v
                    if mask is not None:
                        weights = tile_mask[y]
                        blend_row(state[y], u, a, t, red, green, blue, depth, weights, sums)
                    else:
                        blend_row(state[y], u, a, t, red, green, blue, depth, None, None)
                if inside is not None and outside is not None:
                    inside[first_of_batch + n] = sums[:TILE].sum()
                    outside[first_of_batch + n] = sums[TILE:].sum()
        for y in range(lines):
            for x in range(columns):
                rest = abs(state[y, _T + x])
                covered = ONE - rest
                rgb[top + y, left + x, 0] = state[y, _R + x] + rest * background[0]
                rgb[top + y, left + x, 1] = state[y, _G + x] + rest * background[1]
                rgb[top + y, left + x, 2] = state[y, _B + x] + rest * background[2]
                alpha[top + y, left + x] = covered
                expected_depth[top + y, left + x] = (
                    state[y, _D + x] / covered if covered > ZERO else ZERO
                )
                median_depth[top + y, left + x] = state[y, _MEDIAN + x]
