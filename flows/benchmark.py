"""The benchmark flow: scenes one after the other, then the result record, then MLflow."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from prefect import flow

from flows.scene import SceneOutcome, scene_flow
from flows.suite import SuiteConfig, resolve_scenes
from reports.environment import describe_environment
from reports.record import Result, Row
from reports.result_io import new_run_id
from reports.results_place import ResultsPlace


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
            for s in self.result.scenes
            if s.status == "failed"
        ]


@flow(name="benchmark", flow_run_name="{run_id}", validate_parameters=False)
def benchmark_flow(
    suite: dict[str, Any], run_id: str, store: str, results: str, progress: bool = False
) -> BenchmarkOutcome:
    """Run a suite and write its result record.

    Args:
        suite: The suite's configuration as JSON values.
        run_id: Name of the result's folder.
        store: Root of the artifact store, or its URL.
        results: Folder of the results, or its URL.
        progress: Show progress bars.

    Raises:
        ConfigError: for a suite that cannot run; nothing is written then.
    """
    config = SuiteConfig.model_validate(suite)
    start, created = time.perf_counter(), datetime.now(UTC)
    outcomes: list[SceneOutcome] = []
    for dataset, scene in resolve_scenes(config.datasets):
        outcomes += scene_flow(suite, dataset, scene, store, progress)
    result = Result(
        run_id=run_id,
        suite=config.name,
        created=created.isoformat(timespec="seconds"),
        wall_seconds=time.perf_counter() - start,
        config=config.model_dump(mode="json"),
        environment=describe_environment(),
        scenes=tuple(outcome.result for outcome in outcomes),
    )
    rows = tuple(row for outcome in outcomes for row in outcome.rows)
    pictures = _pictures(outcomes)
    folder = ResultsPlace(results).write(result, rows, pictures)
    return BenchmarkOutcome(folder, result, rows, any(o.bad_input for o in outcomes))


def run_benchmark(
    suite: SuiteConfig, store: Path | str, results: Path | str, progress: bool = False
) -> BenchmarkOutcome:
    """Run a suite in the Prefect that :func:`tasks.prefect_runtime.prefect_runtime` set up.

    Args:
        suite: The suite.
        store: Root of the artifact store, or its URL.
        results: Folder of the results, or its URL; the new one is made in there.
        progress: Show progress bars.

    Raises:
        ConfigError: for a suite that cannot run; nothing is written then.
    """
    return benchmark_flow(
        suite.model_dump(mode="json"), new_run_id(), str(store), str(results), progress
    )


def _pictures(outcomes: Sequence[SceneOutcome]) -> dict[str, Path]:
    return {name: path for outcome in outcomes for name, path in outcome.pictures.items()}
