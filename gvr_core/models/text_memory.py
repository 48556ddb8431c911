"""Semantic vectors of texts that were asked for before: each query brings the same phrases."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from gvr_core.models.base import FloatArray
from gvr_core.models.recent import Recent

MOST_BYTES = 16 * 2**20
"""Of vectors that are kept: 4096 texts at c = 1024."""


class TextMemory:
    """Vectors of the last texts.

    A vector belongs to its text alone: texts are encoded one at a time, since what stands beside
    a text in a batch tints the last digits of its vector (half precision: the third), and then
    results would depend on which queries came before.

    Args:
        encode: Gives the vector (c,) of one text.
        dim: c.
        most_bytes: Limit of what is kept.
    """

    def __init__(
        self, encode: Callable[[str], FloatArray], dim: int, most_bytes: int = MOST_BYTES
    ) -> None:
        self._encode = encode
        self._dim = dim
        self._known: Recent[FloatArray] = Recent(most_bytes, lambda vector: vector.nbytes)

    def vectors(self, texts: Sequence[str]) -> FloatArray:
        """Vectors of texts, from memory where they are there.

        Args:
            texts: Any number of texts, repetitions and none included.

        Returns:
            (t, c) float32, the caller's own.
        """
        rows = np.empty((len(texts), self._dim), np.float32)
        for row, text in zip(rows, texts, strict=True):
            row[:] = self._known.recall(text.encode(), partial(self._vector, text))
        return rows

    def _vector(self, text: str) -> FloatArray:
        # A copy: a row of a larger array would keep all of it.
        return np.array(self._encode(text), np.float32)
