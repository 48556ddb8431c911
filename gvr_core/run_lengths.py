"""Patches read off their run lengths, without drawing whole pictures of them.

COCO's run lengths go down the columns of a picture: a run of pixels outside, one inside, and so
on. They are packed into printable bytes, six bits each, five of them for the number, and from the
fourth run on a number is the difference to the run before last
(https://github.com/cocodataset/cocoapi, ``rleToString``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gvr_core.books import PatchBook
from gvr_core.rendering.compiled import inlined, precise_kernel

BoolArray = NDArray[np.bool_]
Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]


def patch_positions(patches: PatchBook, chosen: Int64Array) -> Float64Array:
    """L_2D: of each of some patches the pixel that is nearest to its centroid.

    The paper says "position" of the patch. The centroid of a concave patch can lie beside it,
    on something else; the nearest pixel of the patch never does. Of several the first counts,
    row by row.

    Args:
        patches: The patches.
        chosen: (v,) indices into the book.

    Returns:
        (v, 2) those pixels' centres, as (x, y).
    """
    at = np.empty((len(chosen), 2), np.float64)
    views = np.searchsorted(patches.view_ptr, chosen, side="right") - 1
    _positions(
        np.asarray(patches.rle),
        np.asarray(patches.rle_ptr),
        np.asarray(chosen, np.int64),
        np.asarray(patches.sizes[views, 0], np.int64),
        at,
    )
    return at


def cropped(patches: PatchBook, patch: int) -> tuple[BoolArray, tuple[int, int]]:
    """A patch's mask within its box: what :meth:`PatchBook.pixels` holds there.

    Args:
        patches: The patches.
        patch: Index into the book.

    Returns:
        The box's pixels (h, w), and its corner (x0, y0).
    """
    x0, y0, x1, y1 = (int(side) for side in patches.boxes[patch])
    pixels = np.zeros((y1 - y0, x1 - x0), np.bool_)
    height = int(patches.sizes[patches.view_of(patch), 0])
    code = np.asarray(patches.rle[patches.rle_ptr[patch] : patches.rle_ptr[patch + 1]])
    _draw(code, height, x0, y0, pixels)
    return pixels, (x0, y0)


@inlined
def _inside(code: NDArray[np.uint8]) -> Int64Array:
    """First and one past the last pixel (runs, 2) of each run inside, down the columns."""
    runs = np.empty((code.size // 2 + 1, 2), np.int64)
    number, shift, found, at = np.int64(0), np.int64(0), 0, np.int64(0)
    last, before_last = np.int64(0), np.int64(0)
    for byte in code:
        bits = np.int64(byte) - 48
        number |= (bits & 31) << shift
        shift += 5
        if bits & 32:
            continue
        if bits & 16:
            number |= np.int64(-1) << shift
        if found > 2:
            number += before_last
        if found % 2 == 1:
            runs[found // 2, 0], runs[found // 2, 1] = at, at + number
        at += number
        before_last, last = last, number
        number, shift, found = np.int64(0), np.int64(0), found + 1
    return runs[: found // 2]


@precise_kernel
def _draw(code: NDArray[np.uint8], height: int, x0: int, y0: int, pixels: BoolArray) -> None:
    for run in _inside(code):
        for pixel in range(run[0], run[1]):
            pixels[pixel % height - y0, pixel // height - x0] = True


@precise_kernel
def _positions(
    rle: NDArray[np.uint8],
    rle_ptr: Int64Array,
    chosen: Int64Array,
    heights: Int64Array,
    at: Float64Array,
) -> None:
    for n in range(chosen.size):
        runs = _inside(rle[rle_ptr[chosen[n]] : rle_ptr[chosen[n] + 1]])
        height = heights[n]
        area, rows, columns = np.int64(0), np.int64(0), np.int64(0)
        for run in runs:
            for x in range(run[0] // height, (run[1] - 1) // height + 1):
                top, end = max(run[0] - x * height, 0), min(run[1] - x * height, height)
                area += end - top
                rows += (end - top) * (top + end - 1) // 2
                columns += (end - top) * x
        middle_row, middle_column = rows / area, columns / area
        least, row, column = np.inf, np.int64(0), np.int64(0)
        for run in runs:
            for x in range(run[0] // height, (run[1] - 1) // height + 1):
                top, end = max(run[0] - x * height, 0), min(run[1] - x * height, height)
                # Of a column only the rows next to the middle can be the nearest.
                for step in range(2):
                    y = min(max(np.int64(np.floor(middle_row)) + step, top), end - 1)
                    offset = (y - middle_row) ** 2 + (x - middle_column) ** 2
                    if offset < least or (
                        offset == least and (y < row or (y == row and x < column))
                    ):
                        least, row, column = offset, y, np.int64(x)
        at[n, 0], at[n, 1] = column + 0.5, row + 0.5
