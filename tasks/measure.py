"""Wall-clock time, processor time and peak memory of a stage."""

from __future__ import annotations

import os
import resource
import sys
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Literal

PeakOf = Literal["stage", "shared", "process"]
"""``stage``: of this block alone, where the kernel lets the peak be reset at its start (Linux:
VmHWM through /proc/self/clear_refs). ``shared``: of this block and of those that ran beside it in
the process. ``process``: since the process began."""

_CLEAR_REFS = Path("/proc/self/clear_refs")
_STATUS = Path("/proc/self/status")


class Measurement:
    """Measures a ``with`` block.

    All three figures are the whole process's, as numba, torch and BLAS threads cannot be told
    apart: blocks that run at the same time in threads of one process are counted in each other,
    and `peak_of` says so. What other processes take is never in them. Pages of files that are
    mapped into memory count as long as they are resident.
    """

    seconds: float = 0.0
    """Wall-clock time."""
    cpu_seconds: float = 0.0
    """User and system time of this process and of the children it waited for."""
    peak_bytes: int = 0
    """Highest resident memory, with what was resident before the block began."""
    peak_of: PeakOf = "process"
    """What the peak is of."""

    def __enter__(self) -> Measurement:
        with _lock:
            reset = _begin(self)
        self.peak_of = "process" if not reset else "shared" if self in _together else "stage"
        self._cpu = _cpu_seconds()
        self._wall = time.perf_counter()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.seconds = time.perf_counter() - self._wall
        self.cpu_seconds = max(_cpu_seconds() - self._cpu, 0.0)
        with _lock:
            peak = _high_water_mark() if self.peak_of != "process" else None
            if peak is None:
                self.peak_of = "process"
                peak = peak_resident()
            elif self in _together:
                self.peak_of = "shared"
            self.peak_bytes = max(peak, self.peak_bytes)
            _running.discard(self)
            _together.discard(self)


_lock = threading.Lock()
_running: set[Measurement] = set()
_together: set[Measurement] = set()
"""Those of the running ones beside which another has run."""


def peak_resident() -> int:
    """Highest resident memory of this process so far, in bytes.

    The kernel's mark of this program's own pages where it keeps one (Linux): ru_maxrss goes on from
    the parent's, through fork and exec, and hides in a child of a big process what the child takes.
    """
    mark = _high_water_mark()
    if mark is not None:
        return mark
    # Bytes on macOS, kibibytes elsewhere.
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def _begin(new: Measurement) -> bool:
    """Reset the peak for a new block; the others keep what they have seen of it so far."""
    so_far = _high_water_mark()
    for other in _running:
        other.peak_bytes = max(other.peak_bytes, so_far or 0)
    if _running:
        _together.update(_running, (new,))
    _running.add(new)
    return _reset_peak()


def _cpu_seconds() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _reset_peak() -> bool:
    """Set the kernel's high-water mark to what is resident now; False where it refuses."""
    if _high_water_mark() is None:
        return False
    try:
        _CLEAR_REFS.write_text("5")
    except OSError:
        return False
    return True


def _high_water_mark() -> int | None:
    try:
        lines = _STATUS.read_text().splitlines()
    except OSError:
        return None
    for line in lines:
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    return None
