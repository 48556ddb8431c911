"""A table of text, and its two faces: rich for the terminal, Markdown for the README."""

from __future__ import annotations

import re
from dataclasses import dataclass

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

JOINT = " / "
"""Between the numbers of one cell."""

_WORD = 10
"""Letters of a head that are kept together: those of "recomputed"."""

TERMINAL_WIDTH = 80
"""Columns of the narrowest terminal that tables are made for."""


@dataclass(frozen=True)
class Sheet:
    """A table: every cell is text already."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    n_names: int
    """Number of leading columns that hold names: aligned left, and folded where too long."""
    notes: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()
    """Names of the numbers in each cell that is no name, where one holds several, joined by
    :data:`JOINT`; a page can then give each a column of its own."""


def printable(text: str) -> str:
    """The text without line breaks and control characters, which could rewrite a terminal."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def to_rich(sheet: Sheet) -> RenderableType:
    """The sheet for a terminal; at most `TERMINAL_WIDTH` columns wide."""
    # The box has a space between columns; a second one where there is room.
    room = sum(_whole_width(sheet, i) + 2 for i in range(len(sheet.columns))) <= TERMINAL_WIDTH
    table = Table(
        box=box.SIMPLE_HEAD,
        padding=(0, 1 if room else 0, 0, 0),
        show_edge=False,
    )
    for i, name in enumerate(sheet.columns):
        is_name = i < sheet.n_names
        width = _number_width(sheet, i)
        table.add_column(
            Text(printable(name)),
            justify="left" if is_name else "right",
            overflow="fold",
            # Where the head is the wider one, folding it makes room.
            no_wrap=not is_name and width >= len(name),
            min_width=None if is_name else max(width, _longest_word(name)),
        )
    for row in sheet.rows:
        table.add_row(*(Text(printable(cell)) for cell in row))
    notes = [Text(printable(note), style="dim") for note in sheet.notes]
    # Not the table's own title, which would be folded to the table's width.
    return Group(Text(printable(sheet.title), style="bold"), table, *notes, Text(""))


def _number_width(sheet: Sheet, column: int) -> int:
    # Numbers never fold, nor words of a head; with too little room, it is the names that do.
    return max((len(row[column]) for row in sheet.rows), default=1)


def _whole_width(sheet: Sheet, column: int) -> int:
    """What a column takes without folding a cell or a word of its head."""
    return max(_number_width(sheet, column), _longest_word(sheet.columns[column]))


def _longest_word(head: str) -> int:
    # A scene's name may stand in a head, and is folded as names are.
    return min(max(map(len, head.split()), default=0), _WORD)


def to_markdown(sheet: Sheet) -> str:
    """The sheet as a Markdown table with its title in bold above and its notes below."""
    rule = [":---" if i < sheet.n_names else "---:" for i in range(len(sheet.columns))]
    lines = [f"**{_escape(sheet.title)}**", ""]
    for cells in (sheet.columns, rule, *sheet.rows):
        shown = cells if cells is rule else [_escape(cell) for cell in cells]
        lines.append(f"| {' | '.join(shown)} |")
    for note in sheet.notes:
        lines += ["", _escape(note)]
    return "\n".join(lines) + "\n"


def _escape(text: str) -> str:
    # What a scene or a method is called must not become a link, a heading or another column. An
    # underscore between two letters is none of these, and names like gallery_0 stay readable.
    special = r"([\\|*`<>\[\]]|(?<![A-Za-z0-9])_|_(?![A-Za-z0-9]))"
    return re.sub(special, r"\\\1", printable(text))
