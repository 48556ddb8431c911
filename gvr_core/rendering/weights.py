"""Sums over tiles of each Gaussian's weights inside and outside of a mask."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gvr_core.rendering.compiled import kernel

FloatArray = NDArray[np.float32]


@kernel
def sum_pairs(n: int, pairs: NDArray[np.int32], values: FloatArray) -> FloatArray:
    """Add up what the pairs of each Gaussian hold, always in the order of tiles.

    A Gaussian may lie in thousands of tiles: the sum over them is kept in double.

    Args:
        n: Number of Gaussians.
        pairs: (P,) int32, the Gaussian of each pair.
        values: (P,) float32.

    Returns:
        (n,) float32.
    """
    sums = np.zeros(n, np.float64)
    for pair in range(pairs.shape[0]):
        sums[pairs[pair]] += values[pair]
    return sums.astype(np.float32)
