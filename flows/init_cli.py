"""``gvr init``: a suite for a folder of scenes of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flows import completion
from flows.options import JsonOption
from gvr_core.method_names import METHODS


def init(
    folder: Annotated[Path, typer.Argument(help="A folder of scenes, or a single scene.")],
    out: Annotated[
        Path | None, typer.Option(help="The file; NAME.toml here, NAME being the folder's.")
    ] = None,
    query: Annotated[
        list[str] | None,
        typer.Option(help="What to find in scenes without labels; may be given more than once."),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            help=f"Of {', '.join(METHODS)}; may be given more than once.",
            autocompletion=completion.methods,
        ),
    ] = None,
    models: Annotated[
        str,
        typer.Option(
            help="onboard, mobile-sam, paper, or oracle where all is labelled.",
            autocompletion=completion.model_sets,
        ),
    ] = "onboard",
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a suite for a folder of your own scenes, ready to edit and to run."""
    from flows import init_commands

    init_commands.init(folder, out, query or [], method or ["gvr-robust"], models, force, as_json)
