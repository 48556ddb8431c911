"""``gvr models``: the checkpoints of the full-strength models."""

from __future__ import annotations

from typing import Annotated

import typer

from flows import models_commands
from gvr_core.weights.folder import models_folder

models_app = typer.Typer(
    help="Look after the checkpoints in the models folder (GVR_MODELS, else .gvr/models).",
    no_args_is_help=True,
)


@models_app.command("ls")
def models_ls(
    as_json: Annotated[
        bool, typer.Option("--json", help="Everything that is known, as JSON.")
    ] = False,
) -> None:
    """List the checkpoints, their licences, and what of them is here."""
    models_commands.models_ls(models_folder(), as_json)


@models_app.command("fetch")
def models_fetch(
    name: Annotated[
        list[str] | None,
        typer.Argument(help="Names as `gvr models ls` says them, or open_clip:MODEL/TAG."),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="All that the manifests list.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bars.")] = False,
) -> None:
    """Fetch checkpoints over the network; a fetch that broke off is gone on with.

    A file takes its name only after its digest was found right and it was read without running
    code. Nothing else of gvr uses the network.
    """
    raise typer.Exit(models_commands.models_fetch(models_folder(), name or [], every, not quiet))


@models_app.command("verify")
def models_verify(
    name: Annotated[
        list[str] | None, typer.Argument(help="Names; all that is here where left out.")
    ] = None,
) -> None:
    """Read checkpoints again and compare their digests; exit code 1 if one is wrong."""
    raise typer.Exit(models_commands.models_verify(models_folder(), name or []))
