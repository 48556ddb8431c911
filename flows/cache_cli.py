"""``gvr cache``: the artifact store."""

from __future__ import annotations

from typing import Annotated

import typer

from flows import completion
from flows.lessons import taught
from flows.options import JsonOption, StoreOption
from flows.places import store_root

cache_app = typer.Typer(help="Look after the artifact store.", no_args_is_help=True)


@cache_app.command("ls", **taught("cache ls"))
def cache_ls(
    stage: Annotated[
        str | None, typer.Option(help="Only this stage.", autocompletion=completion.stages)
    ] = None,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """List what is cached, by stage; of a shared store, both tiers."""
    from flows import cache_commands

    cache_commands.cache_ls(store or store_root(), stage, as_json)


@cache_app.command("verify", **taught("cache verify"))
def cache_verify(
    store: StoreOption = None,
    remote: Annotated[
        bool, typer.Option("--remote", help="Check the shared store too, reading all of it.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Read everything that is cached, and check it against its digest."""
    from flows import cache_commands

    raise typer.Exit(cache_commands.cache_verify(store or store_root(), remote, as_json))


@cache_app.command("push", **taught("cache push"))
def cache_push(store: StoreOption = None, as_json: JsonOption = False) -> None:
    """Put into the shared store what it lacks, and what was found damaged there."""
    from flows import cache_commands

    raise typer.Exit(cache_commands.cache_push(store or store_root(), as_json))


@cache_app.command("gc", **taught("cache gc"))
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
    as_json: JsonOption = False,
) -> None:
    """Remove from the store what nothing refers to."""
    from flows import cache_commands

    cache_commands.cache_gc(store or store_root(), keep_days, dry_run, remote, as_json)
