"""A page as one file: templates filled, style and script inlined, nothing fetched from anywhere.

Names in a result come from whoever made the data: every one is escaped by Jinja, and the page's
own content security policy allows the one script that stands in it, by its digest, and no request.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from reports.sheet import JOINT, Sheet, printable

_SCRIPTS = ("base.js", "votes.js", "evidence.js", "queries.js", "tables.js")
_NUMBER = re.compile(r"^\(?([-+]?[0-9][0-9,]*(?:\.[0-9]+)?)")


@dataclass(frozen=True)
class Td:
    """A cell of a table on a page."""

    text: str
    value: float | None = None
    """What it is sorted by; by its text where None."""
    is_name: bool = False


@dataclass(frozen=True)
class PageTable:
    """A table on a page."""

    title: str
    groups: tuple[tuple[str, int], ...]
    """Heads over several columns, with their width; none where there is one row of heads."""
    heads: tuple[str, ...]
    n_names: int
    rows: tuple[tuple[Td, ...], ...]
    notes: tuple[str, ...] = ()


def page_table(sheet: Sheet) -> PageTable:
    """A sheet for a page: numbers can be sorted, and each of several in a cell has a column."""
    n = sheet.n_names
    if len(sheet.parts) < 2:
        rows = tuple(tuple(cell(text, i < n) for i, text in enumerate(row)) for row in sheet.rows)
        return PageTable(sheet.title, (), sheet.columns, n, rows, sheet.notes)
    width = len(sheet.parts)
    groups = tuple((name, width) for name in sheet.columns[n:])
    heads = (*sheet.columns[:n], *(part for _ in groups for part in sheet.parts))
    rows = tuple(
        (
            *(cell(name, True) for name in row[:n]),
            *(cell(text, False) for whole in row[n:] for text in whole.split(JOINT)),
        )
        for row in sheet.rows
    )
    return PageTable(sheet.title, (("", n), *groups), heads, n, rows, sheet.notes)


def cell(text: str, is_name: bool = False) -> Td:
    """A text as a cell; what begins with a number is sorted by that."""
    shown = printable(text)
    found = None if is_name else _NUMBER.match(shown)
    return Td(shown, float(found[1].replace(",", "")) if found else None, is_name)


def number(value: float | None, spec: str = ".1f", factor: float = 1.0, none: str = "–") -> Td:
    """A number as a cell, sorted by all its digits."""
    return Td(none) if value is None else Td(format(factor * value, spec), factor * value)


def name(text: str) -> Td:
    """A name as a cell."""
    return Td(printable(text), None, True)


def render(template: str, **content: Any) -> str:
    """A page.

    Args:
        template: File name in ``reports/templates``.
        content: What the template asks for.
    """
    style, script = _source("page.css"), _script()
    # The digest is over the very characters between the tags.
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return (
        _environment()
        .get_template(template)
        .render(style=Markup(style), script=Markup(script), script_digest=digest, **content)
    )


def page_tables(sheets: Sequence[Sheet]) -> list[PageTable]:
    """Sheets for a page."""
    return [page_table(sheet) for sheet in sheets]


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("reports", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["printable"] = printable
    return environment


@cache
def _script() -> str:
    """The parts of the script in one function of their own."""
    return '(() => {\n"use strict";\n' + "\n".join(map(_source, _SCRIPTS)) + "})();\n"


@cache
def _source(file: str) -> str:
    return (resources.files("reports") / "templates" / file).read_text(encoding="utf-8")
