"""What was computed last, kept within a limit of memory and found again by a key."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import Generic, TypeVar

V = TypeVar("V")


class Recent(Generic[V]):
    """The last values by key; the ones not asked for longest are forgotten first.

    Threads may share it. Two that miss the same key at once both compute it, and agree.

    Args:
        most_bytes: Limit of what is kept; the newest value is always.
        n_bytes: Memory that a value takes.
    """

    def __init__(self, most_bytes: int, n_bytes: Callable[[V], int]) -> None:
        self._most_bytes = most_bytes
        self._n_bytes = n_bytes
        self._values: OrderedDict[bytes, V] = OrderedDict()
        self._bytes = 0
        self._lock = Lock()

    def recall(self, key: bytes, make: Callable[[], V]) -> V:
        """The value of a key, or else what making it gives.

        Args:
            key: Digest of everything that the value depends on.
            make: Computes it.
        """
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
        value = make()
        with self._lock:
            if key not in self._values:
                self._values[key] = value
                self._bytes += self._n_bytes(value)
            while self._bytes > self._most_bytes and len(self._values) > 1:
                self._bytes -= self._n_bytes(self._values.popitem(last=False)[1])
        return value
