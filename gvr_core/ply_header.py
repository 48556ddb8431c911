"""The header of a splat PLY file, read and weighed before anything is allocated.

plyfile parses the header; this module asks whether the file can hold what the header promises.
The format: Greg Turk, "The PLY Polygon File Format" (1994).
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from plyfile import PlyData, PlyElement, PlyListProperty, PlyParseError

from gvr_core.errors import SplatFormatError

MAX_HEADER_BYTES = 1 << 18
"""A header beyond this is refused. A splat of degree 3 needs 1.5 KB."""


@dataclass(frozen=True)
class VertexTable:
    """Where a PLY file keeps its vertices, and what a row of them looks like."""

    dtype: np.dtype[Any]
    """One field a column, in the file's order and byte order."""
    count: int
    """Rows, at least one."""
    ascii: bool
    """True where the rows are lines of text."""
    offset: int
    """Bytes before the first vertex (binary) or before the first element (ascii)."""
    lines_before: int
    """Lines of other elements before the first vertex (ascii)."""
    comments: tuple[str, ...] = ()
    """The header's comments on the file and on its vertices."""


def read_vertex_table(stream: BinaryIO, size: int, path: Path) -> VertexTable:
    """What the header says about the vertices, once the file is known to be long enough.

    Args:
        stream: The file, at its start.
        size: Its size in bytes.
        path: Its name, for the messages.

    Raises:
        SplatFormatError: if this is no PLY file, its header is broken, it has no vertices or
            keeps lists where only scalars can be, or it promises more than the file holds.
    """
    lines, newline, data_offset = _header_lines(stream, path)
    stub, counts = _without_counts(lines, path)
    try:
        # Without rows to read, this parses the header and nothing else.
        ply = PlyData.read(io.BytesIO(newline.join(stub)), mmap=False)
    except (PlyParseError, ValueError) as error:
        raise SplatFormatError(
            f"the header cannot be read: {error}", path=path, place="header", accepted="PLY 1.0"
        ) from error
    elements = list(zip(ply.elements, counts, strict=True))
    names = [element.name for element, _ in elements]
    if "vertex" not in names:
        raise SplatFormatError(
            f"the file has no vertices, only {', '.join(names) or 'a header'}",
            path=path,
            place="header",
            accepted="an element named vertex",
        )
    position = names.index("vertex")
    for element, count in elements[: position + 1]:
        _refuse_lists(element, count, path)
    _check_promise(elements, size - data_offset, ply.text, path)
    vertex, count = elements[position]
    if count == 0:
        raise SplatFormatError(
            "the file holds no Gaussian", path=path, place="header", accepted="one vertex or more"
        )
    before = elements[:position]
    skipped = sum(n * element.dtype(ply.byte_order).itemsize for element, n in before if n)
    return VertexTable(
        dtype=vertex.dtype(ply.byte_order),
        count=count,
        ascii=ply.text,
        offset=data_offset if ply.text else data_offset + skipped,
        lines_before=sum(n for _, n in before),
        comments=(*ply.comments, *vertex.comments),
    )


def _header_lines(stream: BinaryIO, path: Path) -> tuple[list[bytes], bytes, int]:
    """The header's lines, the line ending it uses, and its length in bytes."""
    head = stream.read(MAX_HEADER_BYTES)
    start = re.match(rb"ply(\r\n|\n|\r)", head)
    if start is None:
        raise SplatFormatError(
            f"this is no PLY file: it begins with {head[:8]!r}",
            path=path,
            accepted="a file that begins with the line 'ply'",
        )
    newline = start[1]
    last = newline + b"end_header" + newline
    end = head.find(last)
    if end < 0:
        raise SplatFormatError(
            "the header has no end",
            path=path,
            place="header",
            accepted=f"a line 'end_header' within the first {MAX_HEADER_BYTES} bytes",
        )
    stop = end + len(last)
    return head[:stop].split(newline), newline, stop


def _without_counts(lines: list[bytes], path: Path) -> tuple[list[bytes], list[int]]:
    """The header with zero rows in every element, and the rows that it really promises."""
    stub, counts = [], []
    columns: set[bytes] = set()
    for number, line in enumerate(lines, start=1):
        words = line.split()
        place = f"header line {number}"
        if words[:1] == [b"element"] and len(words) == 3:
            columns = set()
            if not re.fullmatch(rb"\d{1,18}", words[2]):
                raise SplatFormatError(
                    f"an element with {words[2].decode('ascii', 'replace')!r} rows",
                    path=path,
                    place=place,
                    accepted="a whole number, 0 or more",
                )
            counts.append(int(words[2]))
            line = b" ".join([*words[:2], b"0"])
        elif words[:1] == [b"property"]:
            if words[-1] in columns:
                raise SplatFormatError(
                    f"the column {words[-1].decode('ascii', 'replace')} is there twice",
                    path=path,
                    place=place,
                    accepted="columns with different names",
                )
            columns.add(words[-1])
        stub.append(line)
    return stub, counts


def _refuse_lists(element: PlyElement, count: int, path: Path) -> None:
    """Lists have no fixed size, so neither vertices nor what stands before them may have any."""
    for prop in element.properties:
        if isinstance(prop, PlyListProperty) and (count or element.name == "vertex"):
            raise SplatFormatError(
                "the column is a list",
                path=path,
                place=f"header, element {element.name}, property {prop.name}",
                accepted="one number a column",
            )


def _check_promise(
    elements: list[tuple[PlyElement, int]], available: int, text: bool, path: Path
) -> None:
    """Compare the least that the promised rows can take with what follows the header."""
    # A number and its separator are two characters; the last line may lack its end.
    promised = -1 if text else 0
    for element, count in elements:
        for prop in element.properties:
            if text:
                least = 2
            elif isinstance(prop, PlyListProperty):
                least = np.dtype(prop.list_dtype()[0]).itemsize
            else:
                least = np.dtype(prop.dtype()).itemsize
            promised += count * least
    if promised > available:
        rows = ", ".join(f"{element.name} {count}" for element, count in elements)
        raise SplatFormatError(
            f"the header promises {rows}, which is {promised} bytes or more, but only"
            f" {available} bytes follow it",
            path=path,
            place="header",
            accepted="a whole file whose header tells the truth",
        )
