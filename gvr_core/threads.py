"""How many threads this process may compute with."""

from __future__ import annotations

import os

LIMIT = "GVR_THREADS"
"""Environment variable: at most so many, where several processes share a machine."""


def available_threads() -> int:
    """Number of processors that this process may use, and no more than GVR_THREADS says."""
    limit = os.environ.get(LIMIT, "")
    most = _processors()
    return max(1, min(most, int(limit))) if limit.isdigit() else most


def thread_limits(threads: int) -> dict[str, str]:
    """Environment variables that keep a child process, and its libraries, to so many threads."""
    names = (LIMIT, "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    return dict.fromkeys(names, str(threads))


def _processors() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
