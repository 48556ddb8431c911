"""``gvr run`` and ``gvr schedule``; each function is one command, usable without a shell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from flows.job import Job, exit_code, fill_mlflow, not_filled, prepare
from flows.output import complaints, print_document, say, show_sheet, warn
from flows.places import home
from flows.result_document import result_document
from flows.results_commands import print_tables
from flows.when import When
from reports.mlflow_store import SyncError, begin_store
from reports.sheet import Sheet
from tasks.store import Store

if TYPE_CHECKING:
    from flows.plan import PlannedLine  # imports the stages, and all they compute with


@dataclass(frozen=True)
class PlanDocument:
    """What a run would do."""

    suite: str
    to_compute: int
    """Stages of all lines that are not in the store; lines that share one compute it once."""
    lines: tuple[PlannedLine, ...]


def run(job: Job, progress: bool, as_json: bool = False) -> int:
    """``gvr run``: run a suite, print its tables, fill MLflow.

    Returns:
        Exit code: 0; 1 where a scene failed; 2 where it failed for something the user gave.
    """
    suite = prepare(job)

    from tasks.prefect_loss import prefect_loss
    from tasks.prefect_runtime import prefect_runtime

    store = Store(job.store)
    store.check()

    def get_ready() -> None:
        # A server takes seconds to start, on one core; so do imports, and MLflow's first tables.
        if job.tracking_uri is not None:
            begin_store(job.tracking_uri)
        import flows.benchmark  # noqa: F401

    with prefect_loss(), prefect_runtime(store, home=home() / "prefect", meanwhile=get_ready):
        from flows.benchmark import run_benchmark

        outcome = run_benchmark(suite, job.store, job.results, progress)
        # Prefect's server writes down the last states meanwhile.
        if not as_json:
            print_tables(outcome.result, outcome.rows)
            say(f"\nResult: {outcome.folder}")
        filled = None
        if job.tracking_uri is not None:
            try:
                filled = fill_mlflow(outcome.folder, job.tracking_uri)
            except SyncError as error:
                warn(not_filled(error))
    if as_json:
        content = result_document(outcome.folder, outcome.result, outcome.rows, filled)
        print_document("run", content)
    elif filled is not None:
        say(f"MLflow: {filled}")
    for failure in outcome.failed:
        complaints.print(f"failed: {failure}", style="red", markup=False)
    return exit_code(outcome)


def dry_run(job: Job, as_json: bool = False) -> None:
    """``gvr run --dry-run``: what is in the store, and what a run would compute."""
    from flows.plan import plan

    suite = prepare(job)
    lines = plan(suite, Store(job.store))
    to_do = sum(len(line.to_compute) for line in lines)
    if as_json:
        print_document("run --dry-run", PlanDocument(suite.name, to_do, tuple(lines)))
        return
    rows = [
        (
            f"{line.dataset}/{line.scene}",
            line.line,
            ", ".join(line.to_compute) or "nothing",
            f"{len(line.stages) - len(line.to_compute)} of {len(line.stages)}",
        )
        for line in lines
    ]
    columns = ("scene", "method", "to compute", "cached")
    show_sheet(Sheet(f"{suite.name}: what a run would compute", columns, tuple(rows), n_names=3))
    say(f"{to_do} stages to compute; lines that share a stage compute it once.")


def schedule(job: Job, when: When) -> None:
    """``gvr schedule``: run a suite again and again, until interrupted.

    Raises:
        ConfigError: for a time or a job that cannot be; nothing is scheduled then.
    """
    suite = prepare(job)

    from tasks.prefect_runtime import prefect_runtime

    with prefect_runtime(Store(job.store), home=home() / "prefect", quiet=False) as runtime:
        from flows.schedule import serve_suite

        say(f"{suite.name} runs {when}; Prefect is at {runtime.api_url}, and Ctrl-C ends it.")
        serve_suite(job, suite.name, when)
