"""The vertices of a PLY file, a block of rows at a time, from text or from bytes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from io import TextIOWrapper
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gvr_core.errors import SplatFormatError
from gvr_core.ply_header import VertexTable

BLOCK_ROWS = 8192
"""Vertices read at a time: their columns stay in the processor's cache while they are sorted
into the arrays of the Gaussians, and no second copy of a large file is held in memory."""


def vertex_blocks(stream: BinaryIO, table: VertexTable, path: Path) -> Iterator[NDArray[Any]]:
    """The vertices in order, as structured arrays with one field a column.

    Args:
        stream: The file.
        table: What its header says.
        path: Its name, for the messages.

    Yields:
        (n,) structured arrays, n up to :data:`BLOCK_ROWS`; ``table.count`` rows altogether.
        Columns of text files are float64.

    Raises:
        SplatFormatError: if the rows end early, or a line of text is not the numbers it must be.
    """
    stream.seek(table.offset)
    blocks = _ascii_blocks if table.ascii else _binary_blocks
    return blocks(stream, table, path)


def _binary_blocks(stream: BinaryIO, table: VertexTable, path: Path) -> Iterator[NDArray[Any]]:
    """The bytes of a binary file as they are."""
    for first in range(0, table.count, BLOCK_ROWS):
        rows = min(BLOCK_ROWS, table.count - first)
        content = stream.read(rows * table.dtype.itemsize)
        # The size was checked before, but a file may shrink while it is read.
        if len(content) < rows * table.dtype.itemsize:
            raise _early_end(first + len(content) // table.dtype.itemsize, table.count, path)
        yield np.frombuffer(content, table.dtype)


def _ascii_blocks(stream: BinaryIO, table: VertexTable, path: Path) -> Iterator[NDArray[Any]]:
    """The lines of a text file as numbers."""
    names = table.dtype.names or ()
    dtype = np.dtype([(name, np.float64) for name in names])
    text = TextIOWrapper(stream, encoding="ascii", errors="replace")
    for _ in islice(text, table.lines_before):
        pass
    for first in range(0, table.count, BLOCK_ROWS):
        lines = list(islice(text, min(BLOCK_ROWS, table.count - first)))
        if not lines:
            raise _early_end(first, table.count, path)
        values = _numbers(lines, names, first, path)
        if first + len(lines) < min(first + BLOCK_ROWS, table.count):
            raise _early_end(first + len(lines), table.count, path)
        yield values.view(dtype)[:, 0]
    text.detach()


def _numbers(
    lines: Sequence[str], names: Sequence[str], first: int, path: Path
) -> NDArray[np.float64]:
    """(rows, columns) numbers of lines of text."""
    if all(line.strip() for line in lines):
        try:
            values = np.loadtxt(lines, dtype=np.float64, comments=None, ndmin=2)
            if values.shape == (len(lines), len(names)):
                return values
        except ValueError:
            pass  # found again below, with its place
    for row, line in enumerate(lines, start=first):
        words = line.split()
        if len(words) != len(names):
            raise SplatFormatError(
                f"the line has {len(words)} values",
                path=path,
                place=f"vertex {row}",
                accepted=f"{len(names)} numbers",
            )
        for word, name in zip(words, names, strict=True):
            if not _is_number(word):
                raise SplatFormatError(
                    f"{word[:40]!r} is no number",
                    path=path,
                    place=f"vertex {row}, {name}",
                    accepted="a decimal number",
                )
    raise SplatFormatError(
        "the numbers cannot be read", path=path, place=f"vertices from {first}", accepted="numbers"
    )


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _early_end(row: int, count: int, path: Path) -> SplatFormatError:
    return SplatFormatError(
        f"the file ends early: the header promises {count} vertices",
        path=path,
        place=f"vertex {row}",
        accepted="a whole file",
    )
