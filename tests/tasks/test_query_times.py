"""A query's own time, and its part of what is shared."""

from __future__ import annotations

import time

import numpy as np
import pytest

from gvr_core.workspace import Workspace
from tasks.query_times import QueryTimes


def spend(seconds: float) -> None:
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        pass


def test_shared_time_is_divided_and_no_time_is_lost() -> None:
    workspace = Workspace(np.empty((0, 2), np.float32), None)
    times = QueryTimes(workspace)

    def make() -> np.ndarray:
        spend(0.06)
        return np.zeros(1, np.float32)

    def work() -> str:
        spend(0.01)
        workspace.recall(b"once", make)
        return "done"

    start = time.perf_counter()
    assert [times.time(query, work) for query in ("a", "b", "c")] == ["done"] * 3
    total = time.perf_counter() - start
    assert times.shared_each >= 0.02
    assert set(times.seconds) == {"a", "b", "c"}
    # the first one made what all three share: it does not pay for it alone
    assert all(seconds >= 0.03 for seconds in times.seconds.values())
    assert sum(times.seconds.values()) == pytest.approx(total, rel=0.05)


def test_without_a_query_there_is_nothing_to_divide() -> None:
    times = QueryTimes(Workspace(np.empty((0, 2), np.float32), None))
    assert times.seconds == {} and times.shared_each == 0.0
