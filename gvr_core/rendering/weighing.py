"""Weights of Gaussians under masks: the walk of blending, without a picture.

A Gaussian's weight under a mask is the sum over pixels of mask * alpha T. A tile's Gaussians are
walked through once for all masks that have a pixel in it, and tiles that no mask has a pixel in
are not drawn at all.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gvr_core.rendering.compiled import inlined, kernel, prefer_wide_vectors, prefetch_row
from gvr_core.rendering.layout import MEAN_X, MEAN_Y, ROW, T0, T_MIN, TILE, A, B, C
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
Int64Array = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@kernel
def mark_tiles(start: int, stop: int, masks: BoolArray, present: BoolArray) -> None:
    """Which tiles the masks ``start`` to ``stop`` - 1 have a pixel in.

    Args:
        start: First mask.
        stop: One past the last.
        masks: (K, H, W) bool.
        present: (K, rows of tiles, tiles in a row) bool, False before; written.
    """
    _, height, width = masks.shape
    for k in range(start, stop):
        for y in range(height):
            for column in range(present.shape[2]):
                left = column * TILE
                found = np.int32(0)
                for x in range(left, min(left + TILE, width)):
                    found += np.int32(masks[k, y, x])
                if found > 0:
                    present[k, y // TILE, column] = True


@inlined
def _weigh_row(
    transmittance: FloatArray,
    weights: FloatArray,
    u_left: np.float32,
    a: np.float32,
    t_row: np.float32,
) -> None:
    """What one Gaussian takes of the light in sixteen pixels of a row.

    Args:
        transmittance: (16,) float32, T; negative where blending has stopped.
        weights: (16,) float32, written: alpha T.
        u_left: A dx - B dy in the leftmost pixel.
        a: A, what that grows by from pixel to pixel.
        t_row: log2(opacity) / 8 - (C dy)^2.
    """
    prefer_wide_vectors()
    for x in range(TILE):
        u = u_left + a * np.float32(x)
        t = t_row - u * u
        alpha = min(power_of_two(t), HIGHEST_ALPHA)
        before = transmittance[x]
        after = before - alpha * before
        hit = t >= T_MIN
        goes_on = hit & (after > STOP)
        left = after if goes_on else before
        weights[x] = before - left
        stopped = -abs(before) if hit else before
        transmittance[x] = after if goes_on else stopped


@inlined
def _add_under(sums: FloatArray, weights: FloatArray, portion: FloatArray) -> None:
    for x in range(TILE):
        sums[x] += weights[x] * portion[x]


@kernel
def weigh_tiles(
    start: int,
    stop: int,
    tiles: Int64Array,
    tiles_x: int,
    first_pair: Int64Array,
    pairs: IntArray,
    rows: FloatArray,
    masks: BoolArray,
    first_mask: Int64Array,
    masks_of: IntArray,
    first_value: Int64Array,
    values: FloatArray,
) -> None:
    """Weights of every pair of the tiles ``tiles[start]`` to ``tiles[stop - 1]``.

    Args:
        start: First entry of ``tiles``.
        stop: One past the last.
        tiles: (A,) int64, the tiles that a mask has a pixel in, ascending.
        tiles_x: Tiles in a row of the picture.
        first_pair: (tiles + 1,) int64: where each tile's pairs begin.
        pairs: (P,) int32: Gaussians of each tile, front to back.
        rows: (n, 16) float32, see :mod:`gvr_core.rendering.layout`.
        masks: (K, H, W) bool.
        first_mask: (A + 1,) int64: where the masks of each entry of ``tiles`` begin.
        masks_of: The masks that have a pixel in each of ``tiles``, ascending.
        first_value: (A + 1,) int64: where the weights of each entry of ``tiles`` begin.
        values: float32, 0 before; written: pair by pair the weight under each of its tile's masks.
    """
    _, height, width = masks.shape
    state = aligned(TILE * TILE).reshape((TILE, TILE))
    weights = aligned(TILE)
    batch, lines_of = np.empty((BATCH, ROW), np.float32), np.empty((BATCH, 2), np.int32)
    for entry in range(start, stop):
        tile = tiles[entry]
        own = masks_of[first_mask[entry] : first_mask[entry + 1]]
        depth = own.size
        left, top = (tile % tiles_x) * TILE, (tile // tiles_x) * TILE
        columns, lines = min(TILE, width - left), min(TILE, height - top)
        portions = np.zeros((depth, TILE, TILE), np.float32)
        touched = np.zeros((depth, TILE), np.bool_)
        for d in range(depth):
            for y in range(lines):
                for x in range(columns):
                    if masks[own[d], top + y, left + x]:
                        portions[d, y, x] = ONE
                        touched[d, y] = True
        for y in range(TILE):
            for x in range(TILE):
                state[y, x] = ONE if (y < lines and x < columns) else -ONE
        sums = np.empty((depth, TILE), np.float32)
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
                sums[:] = ZERO
                for y in range(max(lines_of[n, 0], top_line), min(lines_of[n, 1], bottom_line) + 1):
                    dy = np.float32(y) - mean_y
                    v = c * dy
                    _weigh_row(state[y], weights, u_left - b * dy, a, t0 - v * v)
                    for d in range(depth):
                        if touched[d, y]:
                            _add_under(sums[d], weights, portions[d, y])
                place = first_value[entry] + (first_of_batch + n - begin) * depth
                for d in range(depth):
                    values[place + d] = sums[d].sum()


@kernel
def count_weights(
    tiles: Int64Array,
    first_pair: Int64Array,
    pairs: IntArray,
    order: IntArray,
    first_mask: Int64Array,
    first_value: Int64Array,
    values: FloatArray,
    counts: Int64Array,
) -> None:
    """How many weights above zero each Gaussian has, over all tiles and masks.

    Args:
        tiles: As of :func:`weigh_tiles`, as the next two.
        first_pair: See ``tiles``.
        pairs: See ``tiles``.
        order: (n,) int32, number in the set of each row.
        first_mask: As of :func:`weigh_tiles`, as the next two.
        first_value: See ``first_mask``.
        values: See ``first_mask``.
        counts: (N,) int64, 0 before; written.
    """
    for entry in range(tiles.size):
        tile, place = tiles[entry], first_value[entry]
        depth = first_mask[entry + 1] - first_mask[entry]
        for pair in range(first_pair[tile], first_pair[tile + 1]):
            for _ in range(depth):
                if values[place] > ZERO:
                    counts[order[pairs[pair]]] += 1
                place += 1


@kernel
def gather_weights(
    tiles: Int64Array,
    first_pair: Int64Array,
    pairs: IntArray,
    order: IntArray,
    first_mask: Int64Array,
    masks_of: IntArray,
    first_value: Int64Array,
    values: FloatArray,
    ends: Int64Array,
    mask_of: IntArray,
    weight_of: FloatArray,
) -> None:
    """Put the weights above zero Gaussian by Gaussian, of each in the order of tiles.

    Args:
        tiles: As of :func:`count_weights`, as the next seven.
        first_pair: See ``tiles``.
        pairs: See ``tiles``.
        order: See ``tiles``.
        first_mask: See ``tiles``.
        masks_of: As of :func:`weigh_tiles`.
        first_value: See ``tiles``.
        values: See ``tiles``.
        ends: (N,) int64, where each Gaussian's weights begin; moved on to where they end.
        mask_of: (V,) int32, written: the mask of each weight.
        weight_of: (V,) float32, written.
    """
    for entry in range(tiles.size):
        tile, place = tiles[entry], first_value[entry]
        for pair in range(first_pair[tile], first_pair[tile + 1]):
            for m in range(first_mask[entry], first_mask[entry + 1]):
                if values[place] > ZERO:
                    g = order[pairs[pair]]
                    mask_of[ends[g]] = masks_of[m]
                    weight_of[ends[g]] = values[place]
                    ends[g] += 1
                place += 1


@kernel
def sum_weights(
    masks: int, ends: Int64Array, mask_of: IntArray, weight_of: FloatArray, row_ptr: Int64Array
) -> int:
    """Add up each Gaussian's weights by mask; in place, so that what is left stands in front.

    A Gaussian may lie in thousands of tiles: the sums over them are kept in double.

    Args:
        masks: K.
        ends: (N,) int64, where each Gaussian's weights end.
        mask_of: (V,) int32, the mask of each weight; written: that of each sum, ascending.
        weight_of: (V,) float32; written: the sums.
        row_ptr: (N + 1,) int64, written: where each Gaussian's sums begin.

    Returns:
        How many sums there are.
    """
    totals, met = np.zeros(masks, np.float64), np.zeros(masks, np.bool_)
    begin, filled = np.int64(0), 0
    row_ptr[0] = 0
    for g in range(ends.size):
        lowest, highest = masks, -1
        for v in range(begin, ends[g]):
            k = mask_of[v]
            totals[k] += weight_of[v]
            met[k] = True
            lowest, highest = min(lowest, k), max(highest, k)
        begin = ends[g]
        for k in range(lowest, highest + 1):
            if met[k]:
                mask_of[filled] = k
                weight_of[filled] = np.float32(totals[k])
                filled += 1
                totals[k] = 0.0
                met[k] = False
        row_ptr[g + 1] = filled
    return filled
