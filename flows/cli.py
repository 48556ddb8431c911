"""``gvr``: the command line."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from flows import cache_commands, commands, run_commands
from flows.datasets_cli import datasets_app
from flows.init_cli import init
from flows.job import EXIT_BAD_INPUT, EXIT_FAILED, Job
from flows.models_cli import models_app
from flows.places import results_root, store_root
from flows.report_cli import add_report_commands
from flows.schedule_cli import schedule
from flows.suite import DEFAULT_SUITE
from flows.view_cli import view
from gvr_core.errors import GVRError, InputError
from gvr_core.methods import METHODS

app = typer.Typer(
    name="gvr",
    help="Batch evaluation of text-driven visual grounding in 3D Gaussian Splatting scenes.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
cache_app = typer.Typer(help="Look after the artifact store.", no_args_is_help=True)
app.add_typer(cache_app, name="cache")
app.add_typer(models_app, name="models")
app.add_typer(datasets_app, name="datasets")
app.command()(init)
app.command()(schedule)
add_report_commands(app)
app.command()(view)

StoreOption = Annotated[
    str | None,
    typer.Option(
        "--store",
        help="Artifact store, a folder or a shared URL; GVR_STORE, else .gvr/store.",
    ),
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bars.")]


@app.command()
def run(
    suite: Annotated[
        str,
        typer.Argument(
            help="A bundled suite (bench, composite, ablation, stress; lerf_ovs, lerf_mask, "
            "ovs3d, which need their data) or a .toml file."
        ),
    ] = DEFAULT_SUITE,
    method: Annotated[
        list[str] | None, typer.Option(help="Only this method; may be given more than once.")
    ] = None,
    models: Annotated[
        list[str] | None,
        typer.Option(
            help="Only these models: oracle, onboard, mobile-sam, paper, or the suite's own."
        ),
    ] = None,
    dataset: Annotated[
        list[str] | None, typer.Option(help="Only this data set; may be given more than once.")
    ] = None,
    scene: Annotated[
        list[str] | None, typer.Option(help="Only this scene; may be given more than once.")
    ] = None,
    limit: Annotated[
        int | None, typer.Option(help="Only the first so many queries of each scene.")
    ] = None,
    exclude_eval_views: Annotated[
        bool,
        typer.Option("--exclude-eval-views", help="Keep test views out of the books (audit)."),
    ] = False,
    store: StoreOption = None,
    results: Annotated[
        str | None,
        typer.Option(help="Results, a folder or a shared URL; GVR_RESULTS, else .gvr/results."),
    ] = None,
    tracking_uri: Annotated[
        str | None,
        typer.Option(help="MLflow to fill; MLFLOW_TRACKING_URI, else the project's own store."),
    ] = None,
    no_mlflow: Annotated[bool, typer.Option("--no-mlflow", help="Leave MLflow out.")] = False,
    runner: Annotated[
        str | None, typer.Option(help="serial, threads, processes or dask; else the suite's.")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="How many, instead of the suite's.")] = None,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Only list what is cached, and what would be computed."),
    ] = False,
    quiet: QuietOption = False,
) -> None:
    """Run a suite: every method on every scene, with cached stages, into a result and MLflow."""
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
        tracking_uri=None if no_mlflow else commands.tracking_uri(tracking_uri),
    )
    if dry_run:
        run_commands.dry_run(job)
        return
    raise typer.Exit(run_commands.run(job, progress=not quiet))


@app.command()
def ground(
    splat: Annotated[Path, typer.Argument(help="The scene: a .ply or .splat file.")],
    cameras: Annotated[Path, typer.Option(help="A cameras.json, or a folder with a COLMAP model.")],
    query: Annotated[list[str], typer.Option(help="What to find; may be given more than once.")],
    method: Annotated[str, typer.Option(help=f"One of {', '.join(METHODS)}.")] = "gvr-paper",
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
    models: Annotated[
        str, typer.Option(help="onboard, mobile-sam or paper: see `gvr models ls`.")
    ] = "onboard",
    out: Annotated[Path, typer.Option(help="Folder of the files.")] = Path("grounded"),
    max_views: Annotated[
        int | None, typer.Option(help="Use only so many cameras, evenly spaced.")
    ] = None,
    store: StoreOption = None,
    quiet: QuietOption = False,
) -> None:
    """Ground text in one scene of your own: which Gaussians are the thing you name?

    The first query's files are q0.target.ply, q0.without.ply and q0.dyed.ply (those that
    --export asks for, and only where something is found), q0.indices.npy (the target's rows in
    the splat file, counted from 0) and q0.png (a picture); the second's begin with q1.
    answers.json sums all up. A PLY scene keeps its rows to the last bit, with every column.
    """
    commands.ground(
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
    )


@app.command()
def show(
    result: Annotated[
        str, typer.Argument(help="A result's folder or its id; the newest where left out.")
    ] = "",
    markdown: Annotated[bool, typer.Option("--markdown", help="Print Markdown tables.")] = False,
    sheet: Annotated[
        Path | None, typer.Option(help="Also write the pictures side by side into this .png.")
    ] = None,
    into: Annotated[
        Path | None,
        typer.Option(
            help="Put the Markdown tables into this file, between the lines <!-- SUITE --> and "
            "<!-- /SUITE -->, SUITE being the suite's name."
        ),
    ] = None,
) -> None:
    """Print the tables of a result again."""
    commands.show(result, results_root(), markdown, sheet, into)


@app.command()
def score(
    result: Annotated[
        str, typer.Argument(help="A result's folder or its id; the newest where left out.")
    ] = "",
    protocol: Annotated[
        list[str] | None, typer.Option(help="Protocol's id; may be given more than once.")
    ] = None,
    store: StoreOption = None,
) -> None:
    """Score a result's saved predictions again under other protocols; nothing is grounded."""
    commands.score(result, protocol or [], store or store_root(), results_root())


@app.command()
def sync(
    result: Annotated[
        list[str] | None, typer.Argument(help="Results' folders or ids; all where left out.")
    ] = None,
    tracking_uri: Annotated[
        str | None,
        typer.Option(help="MLflow to fill; MLFLOW_TRACKING_URI, else the project's own store."),
    ] = None,
) -> None:
    """Fill MLflow from results, without doubling anything that is there."""
    commands.sync(result or [], results_root(), commands.tracking_uri(tracking_uri))


@app.command()
def ui(
    port: Annotated[int, typer.Option(help="Port; 0 takes a free one.")] = 5000,
    host: Annotated[str, typer.Option(help="Address to listen at.")] = "127.0.0.1",
    exposed: Annotated[
        bool,
        typer.Option(
            "--exposed",
            help="Let --host be an address that other machines reach: MLflow asks nobody for a "
            "password, and whoever reaches it may delete runs.",
        ),
    ] = False,
) -> None:
    """Open MLflow's pages over the project's store, on this machine only unless told."""
    commands.ui(port, host, exposed)


@app.command()
def doctor() -> None:
    """Check this machine: versions, models, data, renderer, store."""
    raise typer.Exit(commands.doctor(store_root()))


@cache_app.command("ls")
def cache_ls(
    stage: Annotated[str | None, typer.Option(help="Only this stage.")] = None,
    store: StoreOption = None,
) -> None:
    """List what is cached, by stage; of a shared store, both tiers."""
    cache_commands.cache_ls(store or store_root(), stage)


@cache_app.command("verify")
def cache_verify(
    store: StoreOption = None,
    remote: Annotated[
        bool, typer.Option("--remote", help="Check the shared store too, reading all of it.")
    ] = False,
) -> None:
    """Read everything that is cached, and check it against its digest."""
    raise typer.Exit(cache_commands.cache_verify(store or store_root(), remote))


@cache_app.command("push")
def cache_push(store: StoreOption = None) -> None:
    """Put into the shared store what it lacks, and what was found damaged there."""
    raise typer.Exit(cache_commands.cache_push(store or store_root()))


@cache_app.command("gc")
def cache_gc(
    keep_days: Annotated[
        float | None,
        typer.Option(help="Also remove results that nobody used for so many days."),
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would go.")] = False,
    store: StoreOption = None,
    remote: Annotated[
        bool,
        typer.Option(
            "--remote",
            help="In the shared store and not in the local folder; there --keep-days counts "
            "from when a result was written.",
        ),
    ] = False,
) -> None:
    """Remove from the store what nothing refers to."""
    cache_commands.cache_gc(store or store_root(), keep_days, dry_run, remote)


def main(arguments: list[str] | None = None) -> Any:
    """Entry point: errors of ours become one line and an exit code."""
    # Ending by SIGTERM unwinds like Ctrl-C, so that servers that were started are stopped.
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    try:
        return app(args=arguments)
    except InputError as error:
        _complain(error)
        sys.exit(EXIT_BAD_INPUT)
    except GVRError as error:
        _complain(error)
        sys.exit(EXIT_FAILED)


def _complain(error: GVRError) -> None:
    Console(stderr=True, soft_wrap=True).print(
        f"gvr: {error}", style="red", markup=False, highlight=False
    )
