"""Checks that the readers of splat files share."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gvr_core.errors import SplatFormatError
from gvr_core.gaussians import FloatArray

UNIT_TOLERANCE = 2.5e-7
"""A quaternion whose length is this close to 1 is left as it is. Rounding a unit quaternion to
float32 moves its length by at most 1.2e-7, so one that was normalised before stays the same
to the last bit however often it is written and read."""


@contextmanager
def open_splat(path: Path) -> Iterator[tuple[BinaryIO, int]]:
    """An opened splat file and its size in bytes.

    Raises:
        SplatFormatError: if it is missing, a folder, not a regular file, or cannot be read.
    """
    try:
        # Asked before opening: a named pipe would block the open for ever.
        if not path.is_file():
            found = "a folder" if path.is_dir() else "special" if path.exists() else "missing"
            raise SplatFormatError(
                f"the file is {found}", path=path, accepted="a regular .ply or .splat file"
            )
        with path.open("rb") as stream:
            yield stream, os.fstat(stream.fileno()).st_size
    except OSError as error:
        raise SplatFormatError(f"the file cannot be read: {error.strerror}", path=path) from error


def require(
    good: NDArray[np.bool_],
    values: NDArray[Any],
    *,
    path: Path,
    column: str,
    first_row: int,
    accepted: str,
    unit: str = "vertex",
) -> None:
    """Refuse a column of numbers where one of them is not as it must be.

    Args:
        good: (n,) bool, True where a value can be used.
        values: (n,) or (n, k) values as the file has them, for the message.
        path: The file.
        column: Name of the column, or of the part of a record.
        first_row: Row in the file of the first value.
        accepted: What would have been accepted.
        unit: What a row is called in this format.

    Raises:
        SplatFormatError: naming the first row that is not good.
    """
    if good.all():
        return
    index = int(np.argmin(good))
    raise SplatFormatError(
        f"the value is {values[index]}",
        path=path,
        place=f"{unit} {first_row + index}, {column}",
        accepted=accepted,
    )


def unit_quaternions(
    raw: NDArray[Any], *, path: Path, column: str, first_row: int, unit: str = "vertex"
) -> FloatArray:
    """Quaternions scaled to length 1.

    Args:
        raw: (n, 4) finite numbers, any length above zero.
        path: The file, for the message.
        column: Name of the columns, for the message.
        first_row: Row in the file of the first quaternion.
        unit: What a row is called in this format.

    Returns:
        (n, 4) float32.

    Raises:
        SplatFormatError: if a quaternion has length zero.
    """
    wide = raw.astype(np.float64)
    length = np.linalg.norm(wide, axis=1)
    require(
        length > 0,
        raw,
        path=path,
        column=column,
        first_row=first_row,
        accepted="a quaternion of positive length",
        unit=unit,
    )
    length[np.abs(length - 1) <= UNIT_TOLERANCE] = 1
    return np.ascontiguousarray((wide / length[:, None]).astype(np.float32))
