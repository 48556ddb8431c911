"""The Prefect task that a runner is given for each try of a scene."""

from __future__ import annotations

import logging
from typing import Any

from prefect import task
from prefect.cache_policies import NO_CACHE
from prefect.states import Completed, Failed, State
from pydantic import TypeAdapter

from flows.scene_outcome import Notes, SceneOutcome, failed_outcome
from flows.scene_process import SceneLost, scene_process
from flows.scene_try import SceneTry, end_scene_run, run_here
from flows.suite import SuiteConfig
from gvr_core.errors import some_of

log = logging.getLogger(__name__)

OUTCOMES = TypeAdapter(tuple[SceneOutcome, ...])


@task(name="scene-try", task_run_name="{name}", persist_result=False, cache_policy=NO_CACHE)
def scene_task(order: dict[str, Any], apart: bool, name: str) -> State[str]:
    """Make one try, wherever the runner has put this.

    Args:
        order: A `SceneTry` as JSON values.
        apart: Make it in a process of its own, which may be ended.
        name: Shown as the name of the task run.

    Returns:
        The outcomes as JSON; ``Failed`` where a line failed.
    """
    outcomes = try_scene(SceneTry.model_validate(order), apart)
    data = OUTCOMES.dump_json(outcomes).decode()
    failed = [outcome.result.method for outcome in outcomes if outcome.failed]
    if failed:
        return Failed(message=f"failed: {some_of(failed)}", data=data)
    return Completed(data=data)


def try_scene(order: SceneTry, apart: bool) -> tuple[SceneOutcome, ...]:
    """Make one try; what goes wrong with the process is an outcome as well.

    Returns:
        An outcome for each of the try's lines. ``attempts`` of its result is 1 where the try
        counts for the line, and 0 where the scene was lost before the line began.
    """
    notes = Notes()
    try:
        if apart:
            with scene_process(order.store, order.threads) as process:
                process.run(order, notes)
        else:
            run_here(order, notes)
        if len(notes.outcomes) < len(order.lines):
            raise SceneLost("its flow run ended early; its log in Prefect says why")
    except Exception as error:
        return lost_outcomes(order, notes, error)
    return tuple(notes.outcomes)


def lost_outcomes(order: SceneTry, notes: Notes, error: Exception) -> tuple[SceneOutcome, ...]:
    """The outcomes of a try that broke off: those that were told, and failures for the rest."""
    ended = {outcome.result.method: outcome for outcome in notes.outcomes}
    known = {line.name: line for line in SuiteConfig.model_validate(order.suite).lines()}
    broke = error if isinstance(error, SceneLost) else SceneLost(f"{type(error).__name__}: {error}")
    at = next((line for line in notes.lines if line not in ended), "")
    end_scene_run(order.flow_run, f"{at}: {broke}" if at else str(broke))
    outcomes = []
    for name in order.lines:
        outcome = ended.get(name)
        if outcome is None:
            begun = not at or name == at
            error = broke if begun else SceneLost(f"not begun; with {at}, {broke}")
            outcome = failed_outcome(order.dataset, order.scene, known[name], error)
            if not begun:
                result = outcome.result.model_copy(update={"attempts": 0})
                outcome = outcome.model_copy(update={"result": result})
        outcomes.append(outcome)
    return tuple(outcomes)
