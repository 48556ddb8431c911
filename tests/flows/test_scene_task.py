"""What is left of a try that broke off."""

from __future__ import annotations

from uuid import uuid4

import pytest

from flows import scene_task
from flows.scene_outcome import Notes, SceneOutcome
from flows.scene_process import SceneLost
from flows.scene_try import SceneTry
from flows.suite import DatasetChoice, SuiteConfig
from gvr_core.methods import MethodConfig
from reports.record import SceneResult

METHODS = tuple(MethodConfig(label=name) for name in "abc")
SUITE = SuiteConfig(name="s", datasets=(DatasetChoice(name="gallery"),), methods=METHODS)


@pytest.fixture
def ended(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Test double: messages of flow runs that were ended, instead of a Prefect server."""
    messages: list[str] = []
    monkeypatch.setattr(scene_task, "end_scene_run", lambda run, message: messages.append(message))
    return messages


@pytest.fixture
def order() -> SceneTry:
    return SceneTry(
        suite=SUITE.model_dump(mode="json"),
        dataset="gallery",
        scene="gallery_0",
        lines=("a", "b", "c"),
        store="store",
        flow_run=uuid4(),
        number=1,
        threads=1,
    )


def notes(begun: str, done: str) -> Notes:
    given = Notes()
    for line in begun:
        given.begun(line)
    for line in done:
        result = SceneResult(
            dataset="gallery", scene="gallery_0", method=line, status="completed", n_views=3
        )
        given.ended(SceneOutcome(result=result))
    return given


def test_lines_that_ended_are_kept_and_those_that_had_not_begun_do_not_count(order, ended) -> None:
    outcomes = scene_task.lost_outcomes(order, notes("ab", "a"), SceneLost("its process died"))
    results = [outcome.result for outcome in outcomes]
    assert [(r.method, r.status, r.attempts) for r in results] == [
        ("a", "completed", 1),
        ("b", "failed", 1),
        ("c", "failed", 0),
    ]
    assert results[0].n_views == 3
    assert results[1].error == "SceneLost: its process died"
    assert results[2].error == "SceneLost: not begun; with b, its process died"
    assert ended == ["b: its process died"] and not any(o.bad_input for o in outcomes)


def test_a_scene_lost_before_its_first_line_counts_for_all(order, ended) -> None:
    outcomes = scene_task.lost_outcomes(order, Notes(), OSError("no cluster"))
    assert {(o.result.error, o.result.attempts) for o in outcomes} == {
        ("SceneLost: OSError: no cluster", 1)
    }


def test_a_flow_run_that_ends_early_is_a_failure(order, ended, monkeypatch) -> None:
    monkeypatch.setattr(scene_task, "run_here", lambda order, listener: listener.begun("a"))
    outcomes = scene_task.try_scene(order, apart=False)
    assert [o.result.attempts for o in outcomes] == [1, 0, 0]
    assert "ended early" in (outcomes[0].result.error or "") and len(ended) == 1


def test_outcomes_travel_as_json(order) -> None:
    (outcome,) = notes("a", "a").outcomes
    data = scene_task.OUTCOMES.dump_json((outcome,))
    assert scene_task.OUTCOMES.validate_json(data) == (outcome,)
