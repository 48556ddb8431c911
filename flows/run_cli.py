"""``gvr run``, ``gvr schedule`` and ``gvr ground``: what computes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flows import completion
from flows.bundled import DEFAULT_SUITE
from flows.lessons import taught
from flows.options import (
    JsonOption,
    ModelsOption,
    NoMlflowOption,
    QuietOption,
    ResultsOption,
    RunnerOption,
    StoreOption,
    SuiteArgument,
    TrackingOption,
    WorkersOption,
)
from flows.places import results_root, store_root
from gvr_core.method_names import METHODS


def add_run_commands(app: typer.Typer) -> None:
    """Register the commands."""
    app.command(**taught("run"))(run)
    app.command(**taught("ground"))(ground)
    app.command(**taught("schedule"))(schedule)


def run(
    suite: SuiteArgument = DEFAULT_SUITE,
    method: Annotated[
        list[str] | None,
        typer.Option(
            help="Only this method; may be given more than once.",
            autocompletion=completion.methods,
        ),
    ] = None,
    models: Annotated[
        list[str] | None,
        typer.Option(
            help="Only these models: oracle, onboard, mobile-sam, paper, or the suite's own.",
            autocompletion=completion.model_sets,
        ),
    ] = None,
    dataset: Annotated[
        list[str] | None,
        typer.Option(
            help="Only this data set; may be given more than once.",
            autocompletion=completion.datasets,
        ),
    ] = None,
    scene: Annotated[
        list[str] | None,
        typer.Option(
            help="Only this scene; may be given more than once.",
            autocompletion=completion.scenes,
        ),
    ] = None,
    limit: Annotated[
        int | None, typer.Option(help="Only the first so many queries of each scene.")
    ] = None,
    exclude_eval_views: Annotated[
        bool,
        typer.Option("--exclude-eval-views", help="Keep test views out of the books (audit)."),
    ] = False,
    store: StoreOption = None,
    results: ResultsOption = None,
    tracking_uri: TrackingOption = None,
    no_mlflow: NoMlflowOption = False,
    runner: RunnerOption = None,
    workers: WorkersOption = None,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Only list what is cached, and what would be computed."),
    ] = False,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Run a suite: every method on every scene, with cached stages, into a result and MLflow."""
    from flows import run_commands
    from flows.job import Job
    from reports.mlflow_store import default_tracking_uri

    job = Job(
        suite=suite,
        methods=tuple(method or ()),
        datasets=tuple(dataset or ()),
        scenes=tuple(scene or ()),
        models=tuple(models or ()),
        limit=limit,
        exclude_eval_views=exclude_eval_views,
        runner=runner,
        workers=workers,
        store=str(store or store_root()),
        results=str(results or results_root()),
        tracking_uri=None if no_mlflow else tracking_uri or default_tracking_uri(),
    )
    if dry_run:
        run_commands.dry_run(job, as_json)
        return
    raise typer.Exit(run_commands.run(job, not quiet, as_json))


def schedule(
    suite: SuiteArgument = DEFAULT_SUITE,
    cron: Annotated[str | None, typer.Option(help="When, such as '0 2 * * *'.")] = None,
    interval: Annotated[
        str | None, typer.Option(help="Or how often: 30m, 6h, 1d; counted from now.")
    ] = None,
    timezone: Annotated[str, typer.Option(help="Time zone of --cron.")] = "UTC",
    runner: RunnerOption = None,
    workers: WorkersOption = None,
    store: StoreOption = None,
    results: ResultsOption = None,
    tracking_uri: TrackingOption = None,
    no_mlflow: NoMlflowOption = False,
) -> None:
    """Run a suite on a schedule, each run in a process of its own, until interrupted.

    A run that is due while the one before still goes on is cancelled. docs/operations.md says how
    to do the same with a Prefect server and workers.
    """
    from flows import run_commands
    from flows.job import Job
    from flows.when import parse_when
    from reports.mlflow_store import default_tracking_uri

    when = parse_when(cron, interval, timezone)
    job = Job(
        suite=suite,
        store=str(store or store_root()),
        results=str(results or results_root()),
        tracking_uri=None if no_mlflow else tracking_uri or default_tracking_uri(),
        runner=runner,
        workers=workers,
    )
    run_commands.schedule(job, when)


def ground(
    splat: Annotated[Path, typer.Argument(help="The scene: a .ply or .splat file.")],
    cameras: Annotated[Path, typer.Option(help="A cameras.json, or a folder with a COLMAP model.")],
    query: Annotated[list[str], typer.Option(help="What to find; may be given more than once.")],
    method: Annotated[
        str,
        typer.Option(
            help=f"One of {', '.join(METHODS)}, or a plugin's.",
            autocompletion=completion.methods,
        ),
    ] = "gvr-paper",
    export: Annotated[
        list[str] | None,
        typer.Option(
            help="What to write as PLY: target (alone; the default), without (the scene without "
            "it) or dyed (the scene with it dyed); may be given more than once."
        ),
    ] = None,
    dye: Annotated[
        str | None, typer.Option(help="Colour of --export dyed, such as #00ff00; red if left out.")
    ] = None,
    models: ModelsOption = "onboard",
    out: Annotated[Path, typer.Option(help="Folder of the files.")] = Path("grounded"),
    max_views: Annotated[
        int | None, typer.Option(help="Use only so many cameras, evenly spaced.")
    ] = None,
    store: StoreOption = None,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Ground text in one scene of your own: which Gaussians are the thing you name?

    The first query's files are q0.target.ply, q0.without.ply and q0.dyed.ply (those that
    --export asks for, and only where something is found), q0.indices.npy (the target's rows in
    the splat file, counted from 0) and q0.png (a picture); the second's begin with q1.
    answers.json sums all up. A PLY scene keeps its rows to the last bit, with every column.
    """
    from flows import ground_commands

    ground_commands.ground(
        splat,
        cameras,
        query,
        method,
        export or ["target"],
        dye,
        out,
        max_views,
        store or store_root(),
        progress=not quiet,
        models=models,
        as_json=as_json,
    )
