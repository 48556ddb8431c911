"""The flow against the plain loop."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import overhead_child
import pytest
from overhead import QUICK, SCENES, FlowRun, Overhead, Work, check_equal, tables
from overhead_child import Stopwatch, check_filled, kept

from flows.suite import SuiteConfig


def flow_run(wall: float, mlflow: float) -> FlowRun:
    parts = {"stages' own work": wall - mlflow, "MLflow": mlflow}
    return FlowRun(wall, wall, parts, {"render": wall / 4})


def test_bars_are_held_to_the_medians() -> None:
    # 60 s of loop allow 81 s of flow.
    flows = (flow_run(80.9, 1.0), flow_run(200.0, 1.0), flow_run(70.0, 1.0))
    found = Overhead(Work(), (60.0, 50.0, 90.0), (1.0, 1.0, 1.0), flows, 12)
    whole, share = found.bars
    assert whole.limit == pytest.approx(81)
    assert whole.met
    assert share.measured == pytest.approx(100 / 80.9)
    assert share.met
    worse = Overhead(Work(), (60.0,), (1.0,), (flow_run(81.1, 3.0),))
    assert [bar.met for bar in worse.bars] == [False, False]
    text = tables(found)
    assert "plain loop | 60.0 (50.0-90.0)" in text
    assert "all 12 metrics" in text


def test_a_difference_in_a_metric_is_no_comparison() -> None:
    same = {"a q v p": {"iou": 0.5, "acc": 1.0}}
    assert check_equal(same, {"a q v p": {"iou": 0.5, "acc": 1.0}}) == 2
    with pytest.raises(RuntimeError, match="differ in 1 places; a q v p"):
        check_equal(same, {"a q v p": {"iou": 0.5}})
    with pytest.raises(RuntimeError, match="b q v p: None"):
        check_equal(same, {**same, "b q v p": {"iou": 0.5}})


def test_the_suite_is_one() -> None:
    suite = SuiteConfig.model_validate(tomllib.loads(Work().suite()))
    assert suite.datasets[0].scenes == SCENES
    assert suite.limit == 1
    assert SuiteConfig.model_validate(tomllib.loads(QUICK.suite())).datasets[0].scenes


def test_a_stopwatch_counts_nested_parts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(overhead_child.time, "perf_counter", lambda: now[0])
    watch = Stopwatch()

    def spend(seconds: float) -> None:
        now[0] += seconds

    inner = watch.around("inner", spend)

    def outer() -> None:
        spend(1)
        inner(10)
        inner(5)

    watch.around("outer", outer)()
    assert watch.seconds == {"inner": 15, "outer": 1}

    @contextmanager
    def server() -> Iterator[str]:
        spend(3)
        try:
            yield "url"
        finally:
            spend(4)

    with watch.around_context("server", server)() as url:
        assert url == "url"
        spend(100)
    assert watch.seconds["server: start"] == 3
    assert watch.seconds["server: stop"] == 4
    with pytest.raises(KeyError), watch.around_context("server", server)():
        raise KeyError("inside")


def test_a_run_whose_mlflow_was_not_filled_is_no_measurement() -> None:
    check_filled([2])
    for created in ([], [0], [1], [2, 2]):
        with pytest.raises(SystemExit, match="MLflow was not filled"):
            check_filled(created)


def test_a_failed_call_leaves_nothing_behind() -> None:
    def sync(number: int) -> int:
        if number < 0:
            raise ValueError("no store")
        return number

    module = SimpleNamespace(sync=sync)
    returned = kept(module, "sync")
    assert module.sync(3) == 3
    with pytest.raises(ValueError, match="no store"):
        module.sync(-1)
    assert returned == [3]
