"""``gvr datasets``: which data sets are here, and whether a folder can be read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flows import completion
from flows.lessons import taught
from flows.options import JsonOption

datasets_app = typer.Typer(
    help="Look at the data sets: benchmarks lie in GVR_DATASETS/NAME, made scenes in GVR_DATA.",
    no_args_is_help=True,
)


@datasets_app.command("ls", **taught("datasets ls"))
def datasets_ls(
    as_json: JsonOption = False,
) -> None:
    """List the data sets that are known, the scenes that are here, and what is missing."""
    from flows import datasets_commands

    datasets_commands.datasets_ls(as_json)


@datasets_app.command("where", **taught("datasets where"))
def datasets_where(as_json: JsonOption = False) -> None:
    """Say which variables and folders are looked at."""
    from flows import datasets_commands

    datasets_commands.datasets_where(as_json)


@datasets_app.command("check", **taught("datasets check"))
def datasets_check(
    path: Annotated[Path, typer.Argument(help="A data set's folder, or a scene of one.")],
    layout: Annotated[
        str | None,
        typer.Option(
            "--as",
            help="lerf_ovs, lerf_mask, ovs3d, native or capture, where the folder looks like"
            " several.",
            autocompletion=completion.layouts,
        ),
    ] = None,
    splats: Annotated[Path | None, typer.Option(help="Folder of trained splats by scene.")] = None,
    splat: Annotated[
        Path | None, typer.Option(help="Trained splat of a capture: a file or an output folder.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Read a folder as the layout it looks like; exit code 2 if something cannot be read.

    Prints what was found, expected and missing, and every repair that reading needed.
    """
    from flows.datasets_check import datasets_check as check

    raise typer.Exit(check(path, layout, splats, splat, as_json))


@datasets_app.command("export", **taught("datasets export"))
def datasets_export(
    dataset: Annotated[
        str,
        typer.Argument(
            help="A data set with exact truth, e.g. composite.",
            autocompletion=completion.datasets,
        ),
    ],
    scene: Annotated[
        str, typer.Argument(help="One of its scenes.", autocompletion=completion.dataset_scenes)
    ],
    layout: Annotated[
        list[str] | None,
        typer.Option(help="lerf_ovs, lerf_mask or ovs3d; may be given more than once. All if not."),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="Gets a folder for each layout; good for GVR_DATASETS.")
    ] = Path("exported"),
    as_json: JsonOption = False,
) -> None:
    """Write a scene in the layouts of published benchmarks, to see a reader or a method work."""
    from flows import datasets_commands

    datasets_commands.datasets_export(dataset, scene, layout or [], out, as_json)
