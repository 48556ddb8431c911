"""The ``[run]`` table: what fits together, what the command line changes, what is missing."""

from __future__ import annotations

from pathlib import Path

import pytest

from flows import run_config
from flows.fan_out import _Scene
from flows.run_config import RunConfig, check_runner, override_run
from flows.scene_outcome import SceneOutcome
from flows.suite import parse_suite
from gvr_core.errors import ConfigError
from gvr_core.threads import available_threads, thread_limits
from reports.record import SceneResult

SUITE = """
name = "mine"
[[datasets]]
name = "gallery"
[run]
runner = "processes"
workers = 3
scenes_in_flight = 2
retries = 4
retry_delay_seconds = 0.5
scene_seconds = 600
"""


def test_a_suite_says_how_it_is_run(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(SUITE)
    run = parse_suite(path).run
    assert run == RunConfig(
        runner="processes",
        workers=3,
        scenes_in_flight=2,
        retries=4,
        retry_delay_seconds=0.5,
        scene_seconds=600,
    )
    assert (run.workers_for(2), run.workers_for(50)) == (2, 3)


@pytest.mark.parametrize(
    ("change", "found", "accepted"),
    [
        (('"processes"', '"proceses"'), "run.runner", None),
        (("retries = 4", "tries = 4"), "run.tries", "retry_delay_seconds"),
        (("workers = 3", "workers = 0"), "run.workers", None),
        (('"processes"', '"threads"'), "cannot end a scene", "processes or dask"),
        (("workers = 3", 'dask_scheduler = "tcp://h:1"'), "'processes'", "dask"),
        (('"processes"', '"dask"\ndask_scheduler = "tcp://h:1"'), "both", "own workers"),
    ],
)
def test_a_mistake_in_it_names_file_and_place(tmp_path, change, found, accepted) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(SUITE.replace(*change))
    with pytest.raises(ConfigError) as refused:
        parse_suite(path)
    assert found in str(refused.value) and str(path) in str(refused.value)
    assert accepted is None or accepted in (refused.value.accepted or "")


def test_the_command_line_changes_it() -> None:
    given = RunConfig(runner="processes", workers=3, scene_seconds=60)
    assert override_run(given, None, None) == given
    assert override_run(given, "serial", None) == RunConfig()
    assert override_run(given, "dask", 5) == RunConfig(runner="dask", workers=5, scene_seconds=60)
    far = RunConfig(runner="dask", dask_scheduler="tcp://h:1")
    assert override_run(far, None, 2) == RunConfig(runner="dask", workers=2)
    with pytest.raises(ConfigError, match=r"--runner.*'serial', 'threads'"):
        override_run(given, "spark", None)
    with pytest.raises(ConfigError, match="workers = 2 with the runner 'serial'"):
        override_run(RunConfig(), None, 2)


def test_a_runner_that_is_not_installed_is_refused_with_the_command(monkeypatch) -> None:
    check_runner(RunConfig(runner="dask"))
    monkeypatch.setattr(run_config.util, "find_spec", lambda name: None)
    check_runner(RunConfig(runner="processes"))
    with pytest.raises(ConfigError, match="needs distributed and prefect_dask") as refused:
        check_runner(RunConfig(runner="dask"))
    assert "pip install 'gvr-bench[dask]'" in (refused.value.accepted or "")


def test_threads_of_a_worker_are_bounded(monkeypatch) -> None:
    most = available_threads()
    for name, value in thread_limits(1).items():
        monkeypatch.setenv(name, value)
    assert available_threads() == 1
    monkeypatch.setenv("GVR_THREADS", str(most + 5))
    assert available_threads() == most
    monkeypatch.setenv("GVR_THREADS", "many")
    assert available_threads() == most


def outcome(line: str, error: str = "", attempts: int = 1, bad: bool = False) -> SceneOutcome:
    result = SceneResult(
        dataset="d",
        scene="s",
        method=line,
        status="failed" if error else "completed",
        error=error or None,
        attempts=attempts,
    )
    return SceneOutcome(result=result, bad_input=bad)


def test_only_what_may_get_better_is_tried_again() -> None:
    scene = _Scene("d", "s", attempts=dict.fromkeys("abcd", 0))
    assert scene.pending(1) == ["a", "b", "c", "d"]
    # a went well, b was wrong input, c took the process with it, d had not begun.
    scene.note(
        [outcome("a"), outcome("b", "no", bad=True), outcome("c", "x"), outcome("d", "y", 0)]
    )
    assert scene.pending(0) == ["d"]
    assert scene.pending(1) == ["d", "c"]
    scene.note([outcome("d"), outcome("c", "x")])
    assert scene.pending(1) == [] and scene.pending(2) == ["c"]
    assert {k: o.result.attempts for k, o in scene.outcomes.items()} == {
        "a": 1,
        "b": 1,
        "c": 2,
        "d": 1,
    }
