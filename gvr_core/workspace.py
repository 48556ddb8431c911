"""What the queries of one scene share, within a limit of memory."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from gvr_core.errors import InputError
from gvr_core.localize import TEXTS_A_BLOCK, relevancy
from gvr_core.models.base import Encoder
from gvr_core.models.recent import Recent
from gvr_core.stopwatch import step

FloatArray = NDArray[np.float32]

MOST_BYTES = 512 * 2**20
"""Of what is kept for a scene."""


class Workspace:
    """The texts of a scene's queries, compared with its patches, and what else queries share.

    An answer does not depend on what is kept here: with or without it, and whichever queries it
    is shared with, it is the same to the last bit.

    Args:
        features: (M, c) unit vectors of the patches, float32 or float16.
        encoder: Encodes the texts, all in one call; None where no text is compared.
        texts: All texts that will be asked for; repetitions count once.
        most_bytes: Limit of what is kept.
    """

    def __init__(
        self,
        features: NDArray[np.floating],
        encoder: Encoder | None,
        texts: Sequence[str] = (),
        most_bytes: int = MOST_BYTES,
    ) -> None:
        self.shared_seconds = 0.0
        """Wall seconds spent on what is shared."""
        self._lock, self._makers, self._since = Lock(), 0, 0.0
        self._features = features
        self._encoder = encoder
        self._rows = {text: row for row, text in enumerate(dict.fromkeys(texts))}
        self._kept: Recent[FloatArray] = Recent(most_bytes, lambda array: array.nbytes)
        # So many texts at a time that two lots fit: the queries', and the canonical phrases'.
        fitting = most_bytes // (8 * max(1, len(features)) * TEXTS_A_BLOCK)
        self._lot = TEXTS_A_BLOCK * max(1, fitting)

    def cosines(self, text: str) -> FloatArray:
        """Cosine (M,) of every patch with a text.

        Raises:
            InputError: for a text that the workspace was not made for.
        """
        row, encoder = self._rows.get(text), self._encoder
        if row is None or encoder is None:
            raise InputError(
                f"the text {text!r} is none of the {len(self._rows)} that were encoded together",
                accepted="the texts that the workspace was made for",
            )
        lot, place = divmod(row, self._lot)

        def encode() -> FloatArray:
            with step("models"):
                return encoder.encode_texts(list(self._rows))

        def compare() -> FloatArray:
            vectors = self.recall(b"texts", encode)[lot * self._lot : (lot + 1) * self._lot]
            with step("relevancy"):
                return relevancy(self._features, vectors)

        cosines: FloatArray = self.recall(b"cosines %d" % lot, compare)[place]
        return cosines

    def recall(self, key: bytes, make: Callable[[], FloatArray]) -> FloatArray:
        """An array that several queries need; made where it is not kept.

        Args:
            key: Names it.
            make: Makes it, of nothing but the scene.
        """

        def timed() -> FloatArray:
            with self._making():
                return make()

        return self._kept.recall(key, timed)

    @contextmanager
    def _making(self) -> Iterator[None]:
        """Time counts once, however many threads, or makers within makers, are at work."""
        with self._lock:
            if self._makers == 0:
                self._since = time.perf_counter()
            self._makers += 1
        try:
            yield
        finally:
            with self._lock:
                self._makers -= 1
                if self._makers == 0:
                    self.shared_seconds += time.perf_counter() - self._since
