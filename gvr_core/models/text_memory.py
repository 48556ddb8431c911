"""Semantic vectors of texts that were asked for before: each query brings the same phrases."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from threading import Lock

import numpy as np

from gvr_core.models.base import FloatArray

MOST_TEXTS = 4096
"""Texts that are kept: 16 MB of vectors of length 1024."""


class TextMemory:
    """Vectors of the last texts; those not asked for longest are forgotten first.

    A vector belongs to its text alone: texts are encoded one at a time, since what stands beside
    a text in a batch tints the last digits of its vector (half precision: the third), and then
    results would depend on which queries came before.

    Threads may share it. Two that miss the same text at once both encode it, and agree.

    Args:
        encode: Gives the vector (c,) of one text.
        dim: c.
        most: Limit of what is kept, texts.
    """

    def __init__(
        self, encode: Callable[[str], FloatArray], dim: int, most: int = MOST_TEXTS
    ) -> None:
        self._encode = encode
        self._dim = dim
        self._most = most
        self._vectors: OrderedDict[str, FloatArray] = OrderedDict()
        self._lock = Lock()

    def vectors(self, texts: Sequence[str]) -> FloatArray:
        """Vectors of texts, from memory where they are there.

        Args:
            texts: Any number of texts, repetitions and none included.

        Returns:
            (t, c) float32, the caller's own.
        """
        rows = np.empty((len(texts), self._dim), np.float32)
        new: dict[str, FloatArray] = {}  # outlives the memory, where a call asks for more
        for row, text in zip(rows, texts, strict=True):
            vector = new.get(text)
            if vector is None:
                vector = self._known(text)
            if vector is None:
                vector = new[text] = self._encode(text)
                self._keep(text, vector)
            row[:] = vector
        return rows

    def _known(self, text: str) -> FloatArray | None:
        with self._lock:
            if text in self._vectors:
                self._vectors.move_to_end(text)
            return self._vectors.get(text)

    def _keep(self, text: str, vector: FloatArray) -> None:
        kept = np.array(vector, np.float32)  # a row of a larger array would keep all of it
        with self._lock:
            self._vectors[text] = kept
            while len(self._vectors) > self._most:
                self._vectors.popitem(last=False)
