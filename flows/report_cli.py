"""``gvr report`` and ``gvr compare``: results as pages, and as verdicts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flows import report_commands
from flows.places import results_root


def add_report_commands(app: typer.Typer) -> None:
    """Register both commands."""
    app.command()(report)
    app.command()(compare)


def report(
    result: Annotated[
        str, typer.Argument(help="A result's folder or its id; the newest where left out.")
    ] = "",
    out: Annotated[
        Path | None, typer.Option(help="The file; .gvr/reports/<id>.html where left out.")
    ] = None,
    max_mb: Annotated[
        float, typer.Option("--max-mb", help="Leave evidence out beyond so many megabytes.")
    ] = 28.0,
) -> None:
    """Make one HTML file of a result: tables, charts, and the evidence behind every answer.

    It opens without a network, on a phone too, and asks for nothing.
    """
    report_commands.report(result, results_root(), out, max_mb)


def compare(
    a: Annotated[str, typer.Argument(help="The earlier result: its folder or id.")],
    b: Annotated[str, typer.Argument(help="The later one.")],
    fail_if_drop: Annotated[
        float | None,
        typer.Option(help="Exit code 1 if a headline number is lower in B by more points."),
    ] = None,
    method: Annotated[
        list[str] | None, typer.Option(help="Only this line; may be given more than once.")
    ] = None,
    common: Annotated[
        bool,
        typer.Option("--common", help="Compare what both have, where they do not have the same."),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Everything, as JSON.")] = False,
    html: Annotated[
        Path | None, typer.Option(help="Also write a page, with pictures of what changed.")
    ] = None,
) -> None:
    """Compare two results, query by query, with intervals and a sign test.

    Exit code 2 for results that cannot be compared: of other queries, views or protocols.
    """
    code = report_commands.compare(
        a, b, results_root(), fail_if_drop, method or [], common, as_json, html
    )
    raise typer.Exit(code)
