"""Wall-clock time, processor time and peak memory of a stage."""

from __future__ import annotations

import os
import resource
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Literal

_CLEAR_REFS = Path("/proc/self/clear_refs")
_STATUS = Path("/proc/self/status")


class Measurement:
    """Measures a ``with`` block.

    All three figures are the whole process's, as numba, torch and BLAS threads cannot be told
    apart: stages that run at the same time in threads of one process are counted in each other.
    """

    seconds: float = 0.0
    """Wall-clock time."""
    cpu_seconds: float = 0.0
    """User and system time of this process and of the children it waited for."""
    peak_bytes: int = 0
    """Highest resident memory, with what was resident before the block began."""
    peak_of: Literal["stage", "process"] = "process"
    """``stage`` where the kernel let the peak be reset at the start (Linux: VmHWM through
    /proc/self/clear_refs); else ``process``: the peak since the process began (ru_maxrss)."""

    def __enter__(self) -> Measurement:
        self.peak_of = "stage" if _reset_peak() else "process"
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
        peak = _high_water_mark() if self.peak_of == "stage" else None
        if peak is None:
            self.peak_of = "process"
            peak = _maximum_resident()
        self.peak_bytes = peak


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


def _maximum_resident() -> int:
    # Bytes on macOS, kibibytes elsewhere.
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
