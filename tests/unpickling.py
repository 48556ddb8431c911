"""What is unpickled while something runs, by Python's own audit events."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Watch:
    """The classes and functions that pickles looked up."""

    found: list[tuple[str, str, str]] = field(default_factory=list)
    """Module, name, and the places (file:line, innermost first) that it was looked up from."""
    on: bool = True

    def by_others(self, allowed: tuple[str, ...]) -> list[tuple[str, str, str]]:
        """Those that were looked up from none of the allowed places."""
        return [item for item in self.found if not any(part in item[2] for part in allowed)]


@contextmanager
def unpickling() -> Iterator[Watch]:
    """Watch every thread of this process. A hook cannot be taken off, only told to look away."""
    watch = Watch()

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if event != "pickle.find_class" or not watch.on:
            return
        frame, places = sys._getframe(1), []
        while frame is not None and len(places) < 40:
            places.append(f"{frame.f_code.co_filename}:{frame.f_code.co_name}")
            frame = frame.f_back
        watch.found.append((str(arguments[0]), str(arguments[1]), " < ".join(places)))

    sys.addaudithook(hook)
    try:
        yield watch
    finally:
        watch.on = False


def plant(path: Path, content: bytes) -> bytes:
    """Put other content in a file's place, which may not be written to; what was there."""
    before = path.read_bytes()
    path.unlink()
    path.write_bytes(content)
    return before
