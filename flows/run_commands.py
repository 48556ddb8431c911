"""``gvr run`` and ``gvr schedule``; each function is one command, usable without a shell."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table
from rich.text import Text

from flows.commands import console, print_tables
from flows.job import Job, exit_code, fill_mlflow, not_filled, prepare
from flows.places import home
from flows.when import When
from reports.mlflow_store import SyncError, begin_store
from tasks.store import Store

warnings = Console(stderr=True)


def run(job: Job, progress: bool) -> int:
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
    print_tables(outcome.result, outcome.rows)
    console.print(f"\nResult: {outcome.folder}", soft_wrap=True, highlight=False)
    if job.tracking_uri is not None:
        try:
            report = fill_mlflow(outcome.folder, job.tracking_uri)
            console.print(f"MLflow: {report}", soft_wrap=True, highlight=False)
        except SyncError as error:
            warnings.print(not_filled(error), style="yellow", markup=False, soft_wrap=True)
    for failure in outcome.failed:
        warnings.print(f"failed: {failure}", style="red", markup=False, soft_wrap=True)
    return exit_code(outcome)


def dry_run(job: Job) -> None:
    """``gvr run --dry-run``: what is in the store, and what a run would compute."""
    from flows.plan import plan

    lines = plan(prepare(job), Store(job.store))
    table = Table("scene", "method", "cached", "to compute", box=None)
    for line in lines:
        missing = ", ".join(line.to_compute) or "nothing"
        cached = f"{len(line.stages) - len(line.to_compute)} of {len(line.stages)}"
        table.add_row(Text(f"{line.dataset}/{line.scene}"), Text(line.line), cached, missing)
    console.print(table)
    to_do = sum(len(line.to_compute) for line in lines)
    console.print(f"{to_do} stages to compute; lines that share a stage compute it once.")


def schedule(job: Job, when: When) -> None:
    """``gvr schedule``: run a suite again and again, until interrupted.

    Raises:
        ConfigError: for a time or a job that cannot be; nothing is scheduled then.
    """
    suite = prepare(job)

    from tasks.prefect_runtime import prefect_runtime

    with prefect_runtime(Store(job.store), home=home() / "prefect", quiet=False) as runtime:
        from flows.schedule import serve_suite

        console.print(
            f"{suite.name} runs {when}; Prefect is at {runtime.api_url}, and Ctrl-C ends it.",
            markup=False,
            soft_wrap=True,
            highlight=False,
        )
        serve_suite(job, suite.name, when)
