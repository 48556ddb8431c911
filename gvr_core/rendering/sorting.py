"""Stable sort by depth: a radix sort of the float32 bit patterns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gvr_core.rendering.compiled import kernel

_BITS = 11
_DIGITS = 1 << _BITS
_PASSES = 3  # 33 bits, enough for a float32


@kernel
def radix_argsort(keys: NDArray[np.uint32], order: NDArray[np.int32]) -> NDArray[np.int32]:
    """Sort indices by their keys; equal keys keep their order.

    Positive float32 numbers sort like their bit patterns read as integers, so depths need no
    other treatment than ``view(np.uint32)``.

    Args:
        keys: (n,) uint32; overwritten.
        order: (n,) int32, the indices that the keys belong to; overwritten.

    Returns:
        (n,) int32, the indices in ascending order of their keys.
    """
    n = keys.shape[0]
    counts = np.zeros((_PASSES, _DIGITS), np.int32)
    for i in range(n):
        key = np.int64(keys[i])
        for p in range(_PASSES):
            counts[p, (key >> (p * _BITS)) & (_DIGITS - 1)] += 1
    other_keys, other_order = np.empty_like(keys), np.empty_like(order)
    for p in range(_PASSES):
        shift = p * _BITS
        if counts[p].max() == n:
            continue  # all keys share this digit
        position = 0
        for d in range(_DIGITS):
            count = counts[p, d]
            counts[p, d] = position
            position += count
        for i in range(n):
            digit = (np.int64(keys[i]) >> shift) & (_DIGITS - 1)
            place = counts[p, digit]
            counts[p, digit] = place + 1
            other_keys[place] = keys[i]
            other_order[place] = order[i]
        keys, other_keys = other_keys, keys
        order, other_order = other_order, order
    return order
