"""Threads for networks on a CPU: one picture or text batch each, and no waiting for each other."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache

from gvr_core.threads import available_threads


@cache
def cpu_workers() -> ThreadPoolExecutor:
    """As many threads as there are processors, each of which computes alone.

    Threads that share one batch wait for each other in a spin, which on a busy machine takes
    several times the processor time of the work itself.
    """
    return ThreadPoolExecutor(available_threads(), "network", initializer=_one_thread)


def _one_thread() -> None:
    import torch

    torch.set_num_threads(1)
