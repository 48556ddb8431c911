"""What commands say: tables for people, or with ``--json`` one document for scripts.

A document is the only thing on standard output then. It is an object that begins with
``document``, the command's name, and ``version``, which is raised when a field changes its meaning
or goes; fields may be added at any time. Progress, warnings and errors go to standard error, and
the exit code is the same with and without.
"""

from __future__ import annotations

import json
from typing import Any

import typer
from pydantic_core import to_jsonable_python
from rich.console import Console

from reports.sheet import Sheet, to_rich

VERSION = 1

console = Console()
complaints = Console(stderr=True, soft_wrap=True)


def print_document(name: str, content: Any) -> None:
    """Print a document.

    Args:
        name: The command, such as ``cache ls``.
        content: A pydantic model, a dataclass or a mapping; its fields are the document's.

    Raises:
        ValueError: for a NaN or an infinity, which JSON does not have.
    """
    fields = to_jsonable_python(content)
    document = {"document": name, "version": VERSION} | fields
    # Not a console's print, which would fold lines; escapes are safe in any locale.
    typer.echo(json.dumps(document, indent=1, allow_nan=False))


def say(text: str) -> None:
    """A line for people, as it stands."""
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def warn(text: str) -> None:
    """A line on standard error about something that does not end the command."""
    complaints.print(text, style="yellow", markup=False, highlight=False)


def complain(text: str) -> None:
    """A line on standard error about something that went wrong."""
    complaints.print(f"gvr: {text}", style="red", markup=False, highlight=False)


def show_sheet(sheet: Sheet) -> None:
    """A table for people: numbers stay whole in 80 columns, names are folded."""
    console.print(to_rich(sheet))
