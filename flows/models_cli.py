"""``gvr models``: the checkpoints of the full-strength models."""

from __future__ import annotations

from typing import Annotated

import typer

from flows import completion
from flows.lessons import taught
from flows.options import JsonOption, QuietOption

models_app = typer.Typer(
    help="Look after the checkpoints in the models folder (GVR_MODELS, else .gvr/models).",
    no_args_is_help=True,
)


@models_app.command("ls", **taught("models ls"))
def models_ls(as_json: JsonOption = False) -> None:
    """List the checkpoints, their licences, and what of them is here."""
    from flows import models_commands
    from gvr_core.weights.folder import models_folder

    models_commands.models_ls(models_folder(), as_json)


@models_app.command("fetch", **taught("models fetch"))
def models_fetch(
    name: Annotated[
        list[str] | None,
        typer.Argument(
            help="Names as `gvr models ls` says them, or open_clip:MODEL/TAG.",
            autocompletion=completion.checkpoints,
        ),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="All that the manifests list.")] = False,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Fetch checkpoints over the network; a fetch that broke off is gone on with.

    A file takes its name only after its digest was found right and it was read without running
    code. Nothing else of gvr uses the network.
    """
    from flows import models_commands
    from gvr_core.weights.folder import models_folder

    code = models_commands.models_fetch(models_folder(), name or [], every, not quiet, as_json)
    raise typer.Exit(code)


@models_app.command("verify", **taught("models verify"))
def models_verify(
    name: Annotated[
        list[str] | None,
        typer.Argument(
            help="Names; all that is here where left out.", autocompletion=completion.checkpoints
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Read checkpoints again and compare their digests; exit code 1 if one is wrong."""
    from flows import models_commands
    from gvr_core.weights.folder import models_folder

    raise typer.Exit(models_commands.models_verify(models_folder(), name or [], as_json))
