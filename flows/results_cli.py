"""Commands on results that are there: listed, shown, scored again, reported, compared, synced."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flows import completion
from flows.lessons import taught
from flows.options import (
    ExposedOption,
    HostOption,
    JsonOption,
    ResultArgument,
    StoreOption,
    TrackingOption,
)
from flows.places import results_root, store_root


def add_results_commands(app: typer.Typer) -> None:
    """Register the commands."""
    app.command(**taught("ls"))(ls)
    app.command(**taught("show"))(show)
    app.command(**taught("report"))(report)
    app.command(**taught("compare"))(compare)
    app.command(**taught("score"))(score)
    app.command(**taught("sync"))(sync)
    app.command(**taught("ui"))(ui)


def ls(as_json: JsonOption = False) -> None:
    """List the results that are here, the newest last."""
    from flows import results_commands

    results_commands.list_results(results_root(), as_json)


def show(
    result: ResultArgument = "",
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
    as_json: JsonOption = False,
) -> None:
    """Print the tables of a result again."""
    from flows import results_commands

    results_commands.show(result, results_root(), markdown, sheet, into, as_json)


def score(
    result: ResultArgument = "",
    protocol: Annotated[
        list[str] | None,
        typer.Option(
            help="Protocol's id; may be given more than once.",
            autocompletion=completion.protocols,
        ),
    ] = None,
    store: StoreOption = None,
    as_json: JsonOption = False,
) -> None:
    """Score a result's saved predictions again under other protocols; nothing is grounded."""
    from flows import results_commands

    results_commands.score(result, protocol or [], store or store_root(), results_root(), as_json)


def sync(
    result: Annotated[
        list[str] | None,
        typer.Argument(
            help="Results' folders or ids; all where left out.",
            autocompletion=completion.results,
        ),
    ] = None,
    tracking_uri: TrackingOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fill MLflow from results, without doubling anything that is there."""
    from flows import results_commands
    from reports.mlflow_store import default_tracking_uri

    mlflow = tracking_uri or default_tracking_uri()
    results_commands.sync(result or [], results_root(), mlflow, as_json)


def ui(
    port: Annotated[int, typer.Option(help="Port; 0 takes a free one.")] = 5000,
    host: HostOption = "127.0.0.1",
    exposed: ExposedOption = False,
) -> None:
    """Open MLflow's pages over the project's store, on this machine only unless told.

    MLflow asks nobody for a password: with --exposed, whoever reaches it may delete runs.
    """
    from reports.mlflow_server import serve_ui

    serve_ui(port, host, exposed=exposed)


def report(
    result: ResultArgument = "",
    out: Annotated[
        Path | None, typer.Option(help="The file; .gvr/reports/<id>.html where left out.")
    ] = None,
    max_mb: Annotated[
        float, typer.Option("--max-mb", help="Leave evidence out beyond so many megabytes.")
    ] = 28.0,
    as_json: JsonOption = False,
) -> None:
    """Make one HTML file of a result: tables, charts, and the evidence behind every answer.

    It opens without a network, on a phone too, and asks for nothing.
    """
    from flows import report_commands

    report_commands.report(result, results_root(), out, max_mb, as_json)


def compare(
    a: Annotated[
        str,
        typer.Argument(
            help="The earlier result: its folder or id.", autocompletion=completion.results
        ),
    ],
    b: Annotated[str, typer.Argument(help="The later one.", autocompletion=completion.results)],
    fail_if_drop: Annotated[
        float | None,
        typer.Option(help="Exit code 1 if a headline number is lower in B by more points."),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            help="Only this line; may be given more than once.",
            autocompletion=completion.methods,
        ),
    ] = None,
    common: Annotated[
        bool,
        typer.Option("--common", help="Compare what both have, where they do not have the same."),
    ] = False,
    as_json: JsonOption = False,
    html: Annotated[
        Path | None, typer.Option(help="Also write a page, with pictures of what changed.")
    ] = None,
) -> None:
    """Compare two results, query by query, with intervals and a sign test.

    Exit code 2 for results that cannot be compared: of other queries, views or protocols.
    """
    from flows import report_commands

    code = report_commands.compare(
        a, b, results_root(), fail_if_drop, method or [], common, as_json, html
    )
    raise typer.Exit(code)
