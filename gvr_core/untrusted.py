"""Files that nobody vouches for: read whole within a bound, parsed within a depth.

What Python's own parsers do with hostile text is right but for its errors: too deep a nesting is
a RecursionError, too long a number a ValueError without a place, and both may also surface long
after the parsing, when somebody prints or walks the value. Here they are one ``ValueError``, and
at once.
"""

from __future__ import annotations

import errno
import json
import os
import re
import stat
import tomllib
from pathlib import Path
from typing import Any

MAX_BYTES = 256 * 2**20
"""Bytes of the largest JSON file that is read: half a million cameras."""

MAX_TOML_BYTES = 64 * 2**10
"""Bytes of the largest TOML file that is read."""

MAX_DEPTH = 64
"""Lists and tables inside each other beyond which a value is refused; 6 is the most we write."""

_INT64 = range(-(2**63), 2**63)
_QUOTED = re.compile(r'"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'')
_NO_KEY = re.compile(r"[=,{}\[\]\n]")


def read_regular(path: Path, most: int = MAX_BYTES) -> bytes:
    """The content of a regular file. Symbolic links are followed.

    A named pipe or a device does not block, and a file of holes does not fill the memory.

    Args:
        path: The file.
        most: Bytes that it may have.

    Raises:
        OSError: if it is missing, cannot be read, is no regular file, or is larger.
    """
    if "\0" in str(path):
        raise FileNotFoundError(errno.ENOENT, "no file name holds a zero byte")
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    with os.fdopen(os.open(path, flags), "rb") as stream:
        found = os.fstat(stream.fileno())
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "it is no regular file")
        if found.st_size > most:
            raise OSError(errno.EFBIG, f"it has {found.st_size} bytes, and {most} are the most")
        return stream.read(found.st_size)


def parse_json(text: str | bytes, **options: Any) -> Any:
    """A JSON value, nested at most :data:`MAX_DEPTH` deep.

    Args:
        text: The whole text.
        options: As :func:`json.loads` takes them.

    Raises:
        json.JSONDecodeError: where it is no JSON, with the place.
        ValueError: for a nesting that is deeper, a number with thousands of digits, or bytes that
            are no text.
    """
    try:
        value = json.loads(text, **options)
    except RecursionError as error:
        raise ValueError(f"nested more than {MAX_DEPTH} deep") from error
    _walk(value)
    return value


def parse_toml(text: str) -> dict[str, Any]:
    """A TOML document, nested at most :data:`MAX_DEPTH` deep, its whole numbers of 64 bits.

    It may hold no zero character: texts become paths.

    Raises:
        ValueError: for anything else; of TOML's own errors the text names line and column.
    """
    # The parser's time grows with the square of a dotted key's parts: 64 KB of them take a minute.
    keys = _NO_KEY.split(_QUOTED.sub("", text))
    if any(key.count(".") > MAX_DEPTH for key in keys):
        raise ValueError(f"a key of more than {MAX_DEPTH} parts")
    try:
        value = tomllib.loads(text)
    except RecursionError as error:
        raise ValueError(f"nested more than {MAX_DEPTH} deep") from error
    _walk(value, numbers=True)
    if "\\u0000" in text or "\\U00000000" in text:
        raise ValueError("a text with a zero character, which no name may hold")
    return value


def read_toml(path: Path) -> dict[str, Any]:
    """The TOML document in a file of at most :data:`MAX_TOML_BYTES`.

    Raises:
        OSError: as :func:`read_regular`.
        ValueError: as :func:`parse_toml`, or for bytes that are no UTF-8.
    """
    # As text mode would: TOML knows no lone carriage return.
    return parse_toml(read_regular(path, MAX_TOML_BYTES).decode().replace("\r\n", "\n"))


def expanded(path: Path) -> Path:
    """A path with ``~`` taken for a home; left as it is where there is none, as shells do."""
    try:
        return path.expanduser()
    except RuntimeError:
        return path


def _walk(value: object, *, numbers: bool = False) -> None:
    """Refuse a nesting that is too deep, and numbers beyond 64 bits; level by level."""
    level = [value]
    for _ in range(MAX_DEPTH + 1):
        below: list[object] = []
        for item in level:
            below.extend(
                item.values() if isinstance(item, dict) else item if isinstance(item, list) else ()
            )
        if numbers and any(type(item) is int and item not in _INT64 for item in below):
            raise ValueError("a whole number of more than 64 bits")
        level = [item for item in below if isinstance(item, dict | list)]
        if not level:
            return
    raise ValueError(f"nested more than {MAX_DEPTH} deep")
