"""Where the time of some work goes, by function of this project.

A thread looks at the stack of the worker many times a second, and counts the innermost function of
the project that is in it: time in numpy, torch or a compiled kernel is that of the function which
called it. Where the worker waits for threads that views were handed to, what they do counts, in
equal parts; other work that is handed on counts where it is waited for.
"""

from __future__ import annotations

import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = tuple(str(ROOT / name) for name in ("gvr_core", "datasets", "tasks", "reports", "flows"))

HANDS_ON = "gvr_core.ordered.in_order"
"""The function that waits for what others do."""
POOL = "views"
"""Names of their threads begin so."""


@dataclass(frozen=True)
class HotSpot:
    """A function, and its part of the time."""

    place: str
    """``module.function``."""
    seconds: float
    share: float
    """Part of the whole, 0 to 1."""


def profile(work: Callable[[], object], every: float = 0.005) -> tuple[float, list[HotSpot]]:
    """Do some work in this thread and say where its time goes.

    Args:
        work: The work.
        every: Seconds between two looks.

    Returns:
        Seconds in all, and the functions, the longest first; they add up to the whole but for what
        lies outside the project.
    """
    worker, done, looks = threading.get_ident(), threading.Event(), 0
    found: dict[str, float] = defaultdict(float)

    def watch() -> None:
        nonlocal looks
        while not done.wait(every):
            for place, part in _places(sys._current_frames(), worker).items():
                found[place] += part
            looks += 1

    watcher = threading.Thread(target=watch, daemon=True)
    start = time.perf_counter()
    watcher.start()
    try:
        work()
    finally:
        seconds = time.perf_counter() - start
        done.set()
        watcher.join()
    ordered = sorted(found.items(), key=lambda item: -item[1])
    n = max(looks, 1)
    return seconds, [HotSpot(place, seconds * count / n, count / n) for place, count in ordered]


def _places(frames: dict[int, FrameType], worker: int) -> dict[str, float]:
    """The functions that one look finds, and the part of it that each gets."""
    place = innermost(frames.get(worker))
    if place != HANDS_ON:
        return {} if place is None else {place: 1.0}
    names = {thread.ident: thread.name for thread in threading.enumerate()}
    others = [frames[i] for i in frames if names.get(i, "").startswith(POOL)]
    busy = [found for found in map(innermost, others) if found is not None]
    parts: dict[str, float] = defaultdict(float)
    for found in busy or [place]:
        parts[found] += 1 / max(len(busy), 1)
    return parts


def innermost(frame: FrameType | None) -> str | None:
    """``module.function`` of the innermost frame in the project; None where there is none."""
    while frame is not None:
        code = frame.f_code
        if code.co_filename.startswith(PACKAGES):
            path = Path(code.co_filename).relative_to(ROOT).with_suffix("")
            return ".".join([*path.parts, code.co_qualname.replace(".<locals>", "")])
        frame = frame.f_back
    return None
