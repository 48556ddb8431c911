"""``gvr schedule``: a suite, again and again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flows import commands, run_commands
from flows.job import Job
from flows.places import results_root, store_root
from flows.suite import DEFAULT_SUITE
from flows.when import parse_when


def schedule(
    suite: Annotated[
        str, typer.Argument(help="A bundled suite or a .toml file, as for `gvr run`.")
    ] = DEFAULT_SUITE,
    cron: Annotated[str | None, typer.Option(help="When, such as '0 2 * * *'.")] = None,
    interval: Annotated[
        str | None, typer.Option(help="Or how often: 30m, 6h, 1d; counted from now.")
    ] = None,
    timezone: Annotated[str, typer.Option(help="Time zone of --cron.")] = "UTC",
    runner: Annotated[
        str | None, typer.Option(help="serial, threads, processes or dask; else the suite's.")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="How many, instead of the suite's.")] = None,
    store: Annotated[
        str | None, typer.Option(help="Artifact store; GVR_STORE, else .gvr/store.")
    ] = None,
    results: Annotated[
        Path | None, typer.Option(help="Folder of the results; GVR_RESULTS, else .gvr/results.")
    ] = None,
    tracking_uri: Annotated[
        str | None,
        typer.Option(help="MLflow to fill; MLFLOW_TRACKING_URI, else the project's own store."),
    ] = None,
    no_mlflow: Annotated[bool, typer.Option("--no-mlflow", help="Leave MLflow out.")] = False,
) -> None:
    """Run a suite on a schedule, each run in a process of its own, until interrupted.

    A run that is due while the one before still goes on is cancelled. docs/operations.md says how
    to do the same with a Prefect server and workers.
    """
    when = parse_when(cron, interval, timezone)
    job = Job(
        suite=suite,
        store=store or str(store_root()),
        results=str(results or results_root()),
        tracking_uri=None if no_mlflow else commands.tracking_uri(tracking_uri),
        runner=runner,
        workers=workers,
    )
    run_commands.schedule(job, when)
