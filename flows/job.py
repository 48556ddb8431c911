"""One benchmark run from its request to MLflow: what `gvr run` and the schedules both do."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict

from flows.exit_codes import EXIT_BAD_INPUT, EXIT_FAILED
from flows.run_config import check_runner, override_run
from flows.suite import SuiteConfig, override, read_suite, resolve_scenes
from gvr_core.models.registry import require_weights
from reports.mlflow_store import SyncError
from reports.result_io import read_result

if TYPE_CHECKING:
    from flows.benchmark import BenchmarkOutcome  # imports Prefect, whose home is then chosen


class Job(BaseModel):
    """What is asked for; simple JSON values, so that a schedule can hold it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    suite: str
    """A bundled suite's name, or a path to a .toml file."""
    store: str
    """Where the artifact store is."""
    results: str
    """Folder of the results."""
    tracking_uri: str | None = None
    """MLflow to fill; None leaves it out."""
    methods: tuple[str, ...] = ()
    datasets: tuple[str, ...] = ()
    scenes: tuple[str, ...] = ()
    models: tuple[str, ...] = ()
    limit: int | None = None
    exclude_eval_views: bool = False
    runner: str | None = None
    workers: int | None = None


def prepare(job: Job) -> SuiteConfig:
    """The suite that a job asks for; all that can be refused is refused here.

    Raises:
        ConfigError: for a name or setting that cannot be, or a runner that is not installed.
        ModelError: for weights that are missing.
    """
    suite = override(
        read_suite(job.suite),
        job.methods,
        job.datasets,
        job.scenes,
        job.limit,
        job.models,
        job.exclude_eval_views,
    )
    suite = suite.model_copy(update={"run": override_run(suite.run, job.runner, job.workers)})
    check_runner(suite.run)
    resolve_scenes(suite.datasets)
    needed = [line.models for line in suite.lines() if line.method.needs_books]
    for i, chosen in enumerate(needed):
        if chosen not in needed[:i]:  # the lines of a set share its models
            require_weights(chosen)
    return suite


def fill_mlflow(folder: Path, uri: str, patient: bool = False) -> str:
    """Fill MLflow from one result.

    Args:
        folder: The result's folder.
        uri: The MLflow to fill.
        patient: Go on as long as MLflow answers; a run does not wait for ever.

    Returns:
        What was written, in words.

    Raises:
        SyncError: if MLflow cannot be filled; the result itself is safe.
    """
    from reports.mlflow_sink import FILL_SECONDS, sync

    result, _ = read_result(folder)
    experiment = str(result.config.get("experiment", "gvr-bench"))
    return str(sync(folder, uri, experiment, None if patient else FILL_SECONDS))


def not_filled(error: SyncError) -> str:
    """What to say when MLflow could not be filled."""
    return f"MLflow was not filled: {error}\nThe result is safe; `gvr sync` fills it later."


def exit_code(outcome: BenchmarkOutcome) -> int:
    """0; 1 where a scene failed; 2 where one failed for something the user gave."""
    if not outcome.failed:
        return 0
    return EXIT_BAD_INPUT if outcome.bad_input else EXIT_FAILED
