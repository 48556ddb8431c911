"""The benchmark flow: all scenes through a runner, then the result record, then MLflow."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from prefect import flow
from prefect.states import Completed, Failed, State

from flows.fan_out import run_scenes
from flows.runners import Placement, open_runner
from flows.scene_outcome import SceneOutcome
from flows.suite import SuiteConfig, resolve_scenes
from reports.environment import describe_environment
from reports.record import Result, Row
from reports.result_io import new_run_id
from reports.results_place import ResultsPlace
from reports.system_load import LoadSampler
from tasks.store import Store

StartedBy = Literal["hand", "schedule"]


@dataclass(frozen=True)
class BenchmarkOutcome:
    """Where a benchmark's result lies, and how it went."""

    folder: Path
    result: Result
    rows: tuple[Row, ...]
    bad_input: bool
    """Whether a scene failed for something the user gave."""

    @property
    def failed(self) -> list[str]:
        """``data set/scene · method: error`` of each that failed."""
        return [
            f"{s.dataset}/{s.scene} · {s.method}: {s.error}"
            + (f" (tried {s.attempts} times)" if s.attempts > 1 else "")
            for s in self.result.scenes
            if s.status == "failed"
        ]


@flow(name="benchmark", flow_run_name="{run_id}", validate_parameters=False)
def benchmark_flow(
    suite: dict[str, Any],
    run_id: str,
    store: str,
    results: str,
    placement: Placement,
    progress: bool = False,
    started_by: StartedBy = "hand",
) -> State[BenchmarkOutcome]:
    """Run a suite and write its result record.

    Args:
        suite: The suite's configuration as JSON values.
        run_id: Name of the result's folder.
        store: Root of the artifact store, or its URL.
        results: Folder of the results, or its URL.
        placement: How its scenes are handed to the task runner.
        progress: Show progress bars.
        started_by: Who started it.

    Returns:
        The outcome; ``Failed`` where a scene failed, naming it and its error.

    Raises:
        ConfigError: for a suite that cannot run; nothing is written then.
    """
    config = SuiteConfig.model_validate(suite)
    start, created = time.perf_counter(), datetime.now(UTC)
    scenes = resolve_scenes(config.datasets)
    with LoadSampler() as sampler:
        outcomes = run_scenes(config, scenes, store, run_id, placement, progress)
    result = Result(
        run_id=run_id,
        suite=config.name,
        created=created.isoformat(timespec="seconds"),
        wall_seconds=time.perf_counter() - start,
        config=config.model_dump(mode="json"),
        environment=describe_environment(),
        scenes=tuple(outcome.result for outcome in outcomes),
        started_by=started_by,
        system=sampler.load(),
    )
    rows = tuple(row for outcome in outcomes for row in outcome.rows)
    pictures = stored_pictures(outcomes, Store(store))
    folder = ResultsPlace(results).write(result, rows, pictures)
    outcome = BenchmarkOutcome(folder, result, rows, any(o.bad_input for o in outcomes))
    if outcome.failed:
        return Failed(message="\n".join(outcome.failed), data=outcome)
    return Completed(message=f"{len(scenes)} scenes", data=outcome)


def run_benchmark(
    suite: SuiteConfig,
    store: Path | str,
    results: Path | str,
    progress: bool = False,
    started_by: StartedBy = "hand",
) -> BenchmarkOutcome:
    """Run a suite in the Prefect that :func:`tasks.prefect_runtime.prefect_runtime` set up.

    Args:
        suite: The suite.
        store: Root of the artifact store, or its URL.
        results: Folder of the results, or its URL; the new one is made in there.
        progress: Show progress bars.
        started_by: Who started it.

    Raises:
        ConfigError: for a suite that cannot run; nothing is written then.
    """
    with open_runner(suite.run, len(resolve_scenes(suite.datasets))) as (task_runner, placement):
        state = benchmark_flow.with_options(task_runner=task_runner)(
            suite.model_dump(mode="json"),
            new_run_id(),
            str(store),
            str(results),
            placement,
            progress,
            started_by,
            return_state=True,
        )
    outcome = state.result(raise_on_failure=False)
    if isinstance(outcome, BaseException):
        raise outcome
    return outcome


def stored_pictures(outcomes: Sequence[SceneOutcome], store: Store) -> dict[str, Path]:
    """Where the pictures of outcomes lie, and the evidence: name in the result -> file."""
    pictures = {}
    for outcome in outcomes:
        if outcome.pictures:
            # A worker on another machine has left them in the shared store alone.
            keys = {timing.stage: timing.key for timing in outcome.result.stages}
            store.lookup("evaluate", keys["evaluate"])
        pictures |= {name: store.path(picture) for name, picture in outcome.pictures.items()}
    return pictures
