"""Wall seconds of queries that share some of their work."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

from gvr_core.workspace import Workspace

T = TypeVar("T")


class QueryTimes:
    """Tells a query's own time from the time of what it shares with others.

    Args:
        shared: What the queries share.
    """

    def __init__(self, shared: Workspace) -> None:
        self._shared = shared
        self._own: dict[str, float] = {}

    def time(self, query: str, work: Callable[[], T]) -> T:
        """Do the work of a query, and keep its time.

        Args:
            query: The query's id.
            work: What to do.
        """
        start, before = time.perf_counter(), self._shared.shared_seconds
        result = work()
        elapsed = time.perf_counter() - start
        self._own[query] = elapsed - (self._shared.shared_seconds - before)
        return result

    @property
    def shared_each(self) -> float:
        """Seconds of what is shared, divided by the number of queries."""
        return self._shared.shared_seconds / max(1, len(self._own))

    @property
    def seconds(self) -> dict[str, float]:
        """Query -> its own seconds and an equal part of those of what is shared."""
        return {query: own + self.shared_each for query, own in self._own.items()}
