"""``gvr datasets``: which data sets are here, and whether a folder can be read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flows import datasets_commands

datasets_app = typer.Typer(
    help="Look at the data sets: benchmarks lie in GVR_DATASETS/NAME, made scenes in GVR_DATA.",
    no_args_is_help=True,
)


@datasets_app.command("ls")
def datasets_ls(
    as_json: Annotated[
        bool, typer.Option("--json", help="Everything that is known, as JSON.")
    ] = False,
) -> None:
    """List the data sets that are known, the scenes that are here, and what is missing."""
    datasets_commands.datasets_ls(as_json)


@datasets_app.command("where")
def datasets_where() -> None:
    """Say which variables and folders are looked at."""
    datasets_commands.datasets_where()


@datasets_app.command("check")
def datasets_check(
    path: Annotated[Path, typer.Argument(help="A data set's folder, or a scene of one.")],
    layout: Annotated[
        str | None,
        typer.Option(
            "--as",
            help="lerf_ovs, lerf_mask, ovs3d, native or capture, where the folder looks like"
            " several.",
        ),
    ] = None,
    splats: Annotated[Path | None, typer.Option(help="Folder of trained splats by scene.")] = None,
    splat: Annotated[
        Path | None, typer.Option(help="Trained splat of a capture: a file or an output folder.")
    ] = None,
) -> None:
    """Read a folder as the layout it looks like; exit code 2 if something cannot be read.

    Prints what was found, expected and missing, and every repair that reading needed.
    """
    raise typer.Exit(datasets_commands.datasets_check(path, layout, splats, splat))


@datasets_app.command("export")
def datasets_export(
    dataset: Annotated[str, typer.Argument(help="A data set with exact truth, e.g. composite.")],
    scene: Annotated[str, typer.Argument(help="One of its scenes.")],
    layout: Annotated[
        list[str] | None,
        typer.Option(help="lerf_ovs, lerf_mask or ovs3d; may be given more than once. All if not."),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="Gets a folder for each layout; good for GVR_DATASETS.")
    ] = Path("exported"),
) -> None:
    """Write a scene in the layouts of published benchmarks, to see a reader or a method work."""
    datasets_commands.datasets_export(dataset, scene, layout or [], out)
