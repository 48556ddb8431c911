"""How long the steps of a query take, without any step knowing who asks."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field


@dataclass
class _Laps:
    seconds: dict[str, float] = field(default_factory=dict)
    open: list[str] = field(default_factory=list)
    last: float = field(default_factory=time.perf_counter)

    def turn(self) -> None:
        """Give the time since the last turn to the innermost open step."""
        now = time.perf_counter()
        if self.open:
            name = self.open[-1]
            self.seconds[name] = self.seconds.get(name, 0.0) + now - self.last
        self.last = now


_running: ContextVar[_Laps | None] = ContextVar("running", default=None)


@contextmanager
def recorded() -> Iterator[dict[str, float]]:
    """Record the steps taken inside of the block, in this thread.

    Yields:
        Step -> wall seconds, filled in as the steps end. A step within another one counts for
        itself alone. Where recordings are nested, the inner one has the steps to itself.
    """
    laps = _Laps()
    token = _running.set(laps)
    try:
        yield laps.seconds
    finally:
        _running.reset(token)


@contextmanager
def step(name: str) -> Iterator[None]:
    """Give the time of the block to a step, where somebody records."""
    laps = _running.get()
    if laps is None:
        yield
        return
    laps.turn()
    laps.open.append(name)
    try:
        yield
    finally:
        laps.turn()
        laps.open.pop()
