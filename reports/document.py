"""Tables inside a document that people write: a block between two marker lines is replaced."""

from __future__ import annotations

import re
from pathlib import Path

from gvr_core.atomic import atomic_write
from reports.result_check import ResultError


def replace_block(path: Path, name: str, text: str) -> None:
    """Replace what stands between ``<!-- name -->`` and ``<!-- /name -->``, each on its own line.

    The file appears changed as a whole or not at all.

    Args:
        path: A text file that has both lines once, in this order.
        name: Name of the block.
        text: What is to stand there.

    Raises:
        ResultError: for a file that cannot be read or written, or lacks a marker line, or has one
            twice or both the wrong way round.
    """
    path = path.resolve()  # of a link, the file is replaced and not the link
    content, begin, end = _find_block(path, name)
    newline = "\r\n" if "\r\n" in begin.group() else "\n"
    body = newline.join(text.strip("\n").splitlines())
    changed = content[: begin.end()] + body + newline + content[end.start() :]
    try:
        with atomic_write(path) as stream:
            stream.write(changed.encode("utf-8"))
    except OSError as error:
        raise ResultError(f"cannot be written: {error}", path=path) from error


def read_block(path: Path, name: str) -> str:
    """What stands between ``<!-- name -->`` and ``<!-- /name -->``.

    Args:
        path: A text file that has both lines once, in this order.
        name: Name of the block.

    Raises:
        ResultError: for a file that cannot be read, or has no such block or several.
    """
    content, begin, end = _find_block(path, name)
    return content[begin.end() : end.start()]


def _find_block(path: Path, name: str) -> tuple[str, re.Match[str], re.Match[str]]:
    """A file's text, and the two marker lines of a block in it."""
    try:
        # Not read_text, which would lose the file's own line ends.
        content = path.read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ResultError(f"cannot be read: {error}", path=path, accepted="UTF-8 text") from error
    begin, end = (_only_line(path, content, f"<!-- {mark}{name} -->") for mark in ("", "/"))
    if begin.start() > end.start():
        raise ResultError(
            "the block ends before it begins",
            path=path,
            place=f"line {_line_number(content, end)}",
            accepted=f"<!-- {name} -->, then <!-- /{name} -->",
        )
    return content, begin, end


def _only_line(path: Path, content: str, marker: str) -> re.Match[str]:
    """The one line that holds the marker and nothing else, with its line end."""
    lines = list(re.finditer(rf"^{re.escape(marker)}[ \t]*(?:\r?\n|\Z)", content, re.MULTILINE))
    if len(lines) != 1:
        places = ", ".join(str(_line_number(content, line)) for line in lines)
        raise ResultError(
            f"the marker {marker} stands there {len(lines)} times",
            path=path,
            place=f"lines {places}" if lines else None,
            accepted=f"one line {marker}",
        )
    return lines[0]


def _line_number(content: str, line: re.Match[str]) -> int:
    return content.count("\n", 0, line.start()) + 1
