"""From masks and binned Gaussians to each Gaussian's weight under each mask, as a sparse matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gvr_core.rendering.compiled import run_pieces
from gvr_core.rendering.layout import TILE, Window
from gvr_core.rendering.weighing import (
    count_weights,
    gather_weights,
    mark_tiles,
    sum_weights,
    weigh_tiles,
)

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int32]
Int64Array = NDArray[np.int64]

_TILES_A_PIECE = 20
_MASKS_A_PIECE = 8


@dataclass(frozen=True, eq=False)
class MaskedTiles:
    """The tiles in which masks have pixels, and which masks those are."""

    tiles: Int64Array
    """(A,) numbers of the tiles, row by row, ascending."""
    first_mask: Int64Array
    """(A + 1,) where the masks of each tile begin in ``masks_of``."""
    masks_of: IntArray
    """Masks of each tile, ascending."""
    window: Window
    """The smallest rectangle of tiles that holds them all."""


def masked_tiles(masks: BoolArray, threads: int) -> MaskedTiles | None:
    """Where masks have pixels; None where all of them are empty.

    Args:
        masks: (K, H, W) bool.
        threads: Most threads to use.
    """
    count, height, width = masks.shape
    shape = -(-height // TILE), -(-width // TILE)
    present = np.zeros((count, *shape), np.bool_)
    step = _MASKS_A_PIECE

    def mark_piece(piece: int) -> None:
        mark_tiles(piece * step, min((piece + 1) * step, count), masks, present)

    run_pieces(mark_piece, -(-count // step), threads)
    used: BoolArray = np.logical_or.reduce(present, axis=0)
    if not used.any():
        return None
    tiles = np.flatnonzero(used)
    owns = np.ascontiguousarray(present.reshape(count, -1)[:, tiles].T)
    lines, columns = np.flatnonzero(used.any(axis=1)), np.flatnonzero(used.any(axis=0))
    return MaskedTiles(
        tiles,
        np.cumsum([0, *owns.sum(axis=1)], dtype=np.int64),
        np.nonzero(owns)[1].astype(np.int32),
        Window(
            (int(columns[0]), int(columns[-1]) + 1),
            (int(lines[0]), int(lines[-1]) + 1),
        ),
    )


def sums_under_masks(
    n: int,
    masks: BoolArray,
    where: MaskedTiles,
    rows: NDArray[np.float32],
    order: IntArray,
    tiles_x: int,
    first_pair: Int64Array,
    pairs: IntArray,
    threads: int,
) -> sparse.csr_array:
    """Weights of Gaussians under masks.

    Args:
        n: N, size of the whole set.
        masks: (K, H, W) bool.
        where: Of :func:`masked_tiles`.
        rows: (n, 16) Gaussians seen, front to back.
        order: (n,) their numbers in the set.
        tiles_x: Tiles in a row of the picture.
        first_pair: (tiles + 1,) where each tile's pairs begin.
        pairs: (P,) places in ``rows``, of each tile in turn, front to back.
        threads: Most threads to use.

    Returns:
        (N, K) float32, columns ascending, nothing stored that is 0.
    """
    depths = np.diff(where.first_mask)
    sizes = np.diff(first_pair)[where.tiles] * depths
    first_value = np.cumsum([0, *sizes], dtype=np.int64)
    values = np.zeros(int(first_value[-1]), np.float32)
    step = _TILES_A_PIECE

    def weigh_piece(piece: int) -> None:
        span = piece * step, min((piece + 1) * step, where.tiles.size)
        weigh_tiles(
            *span, where.tiles, tiles_x, first_pair, pairs, rows, masks,
            where.first_mask, where.masks_of, first_value, values,
        )  # fmt: skip

    run_pieces(weigh_piece, -(-where.tiles.size // step), threads)
    counts = np.zeros(n, np.int64)
    count_weights(
        where.tiles, first_pair, pairs, order, where.first_mask, first_value, values, counts
    )
    ends = np.cumsum(counts) - counts
    mask_of = np.empty(int(counts.sum()), np.int32)
    weight_of = np.empty(mask_of.size, np.float32)
    gather_weights(
        where.tiles, first_pair, pairs, order, where.first_mask, where.masks_of, first_value,
        values, ends, mask_of, weight_of,
    )  # fmt: skip
    row_ptr = np.empty(n + 1, np.int64)
    filled = sum_weights(len(masks), ends, mask_of, weight_of, row_ptr)
    return sparse.csr_array((weight_of[:filled], mask_of[:filled], row_ptr), shape=(n, len(masks)))
