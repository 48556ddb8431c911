"""Where the time of some work goes, by function of this project.

A thread looks at the stack of the worker many times a second, and counts the innermost function of
the project that is in it: time in numpy, torch or a compiled kernel is that of the function which
called it. Work that functions hand to other threads counts where they wait for it.
"""

from __future__ import annotations

import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = tuple(str(ROOT / name) for name in ("gvr_core", "datasets", "tasks", "reports", "flows"))


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
    worker, found, done = threading.get_ident(), Counter[str](), threading.Event()

    def watch() -> None:
        while not done.wait(every):
            place = innermost(sys._current_frames().get(worker))
            if place is not None:
                found[place] += 1
            found[""] += 1

    watcher = threading.Thread(target=watch, daemon=True)
    start = time.perf_counter()
    watcher.start()
    try:
        work()
    finally:
        seconds = time.perf_counter() - start
        done.set()
        watcher.join()
    looks = max(found.pop("", 0), 1)
    return seconds, [
        HotSpot(place, seconds * count / looks, count / looks)
        for place, count in found.most_common()
    ]


def innermost(frame: FrameType | None) -> str | None:
    """``module.function`` of the innermost frame in the project; None where there is none."""
    while frame is not None:
        code = frame.f_code
        if code.co_filename.startswith(PACKAGES):
            path = Path(code.co_filename).relative_to(ROOT).with_suffix("")
            return ".".join([*path.parts, code.co_qualname.replace(".<locals>", "")])
        frame = frame.f_back
    return None
