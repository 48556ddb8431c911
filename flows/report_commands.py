"""``gvr report`` and ``gvr compare``: pages and verdicts made from results."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from flows.exit_codes import EXIT_FAILED
from flows.output import complaints, print_document, say, show_sheet, warn
from flows.places import home
from flows.results_commands import find_result
from gvr_core.atomic import atomic_write
from gvr_core.errors import ConfigError
from reports.result_io import read_result
from reports.run_comparison_sheets import number_sheets, query_sheets


@dataclass(frozen=True)
class ReportDocument:
    """The page that was written."""

    result: Path
    report: Path
    bytes: int


def report(
    name: str, root: Path | str, out: Path | None, most_megabytes: float, as_json: bool = False
) -> Path:
    """``gvr report``: a result as one HTML file.

    Returns:
        The file.

    Raises:
        ConfigError: for a result that is not there.
        ResultError: for one that is damaged, or a file that cannot be written.
    """
    from reports.html_report import report_page

    if not most_megabytes >= 0:
        raise ConfigError(f"--max-mb is {most_megabytes}", accepted="0 or more")
    folder = find_result(name, root)
    path = home() / "reports" / f"{folder.name}.html" if out is None else out
    write_page(path, report_page(folder, int(most_megabytes * 1e6)))
    size = path.stat().st_size
    if as_json:
        print_document("report", ReportDocument(folder, path, size))
    else:
        say(f"Report: {path} ({size / 1e6:.1f} MB)")
    return path


def write_page(path: Path, text: str) -> None:
    """Write a page, whole or not at all.

    Raises:
        ConfigError: for a path that cannot be written.
    """
    try:
        with atomic_write(path) as stream:
            stream.write(text.encode("utf-8"))
    except OSError as error:
        raise ConfigError(
            f"cannot be written: {error.strerror}",
            path=path,
            accepted="a file in a folder of yours",
        ) from error


def compare(
    first: str,
    second: str,
    root: Path | str,
    fail_if_drop: float | None,
    methods: Sequence[str],
    common: bool,
    as_json: bool,
    html: Path | None,
) -> int:
    """``gvr compare``: what changed from one result to another.

    Returns:
        Exit code: 0; 1 where a headline number dropped by more than ``fail_if_drop`` points.

    Raises:
        ConfigError: for a result or a method that is not there.
        ResultError: for results that cannot be compared.
    """
    from reports.run_comparison import compare_runs
    from reports.run_comparison_json import as_json as to_json

    if fail_if_drop is not None and not (math.isfinite(fail_if_drop) and fail_if_drop >= 0):
        raise ConfigError(f"--fail-if-drop is {fail_if_drop}", accepted="points, 0 or more")
    folders = find_result(first, root), find_result(second, root)
    a, b = (read_result(folder) for folder in folders)
    found = compare_runs(a, b, methods, common)
    if as_json:
        print_document("compare", to_json(found, fail_if_drop))
    else:
        for text in (*found.left_out, *found.notes):
            warn(f"note: {text}")
        for sheet in (*number_sheets(found), *query_sheets(found)):
            show_sheet(sheet)
    if html is not None:
        from reports.html_compare import compare_page

        write_page(html, compare_page(found, folders, fail_if_drop))
        complaints.print(f"Page: {html}", highlight=False, markup=False)
    dropped = [] if fail_if_drop is None else found.dropped(fail_if_drop)
    for number in dropped:
        complaints.print(
            f"dropped: {number.dataset} · {number.method} · {number.column.title}: "
            f"{100 * number.a:.1f} to {100 * number.b:.1f}, {number.drop:.1f} points",
            style="red",
            markup=False,
        )
    return EXIT_FAILED if dropped else 0
