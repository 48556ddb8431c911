"""Reading and writing sets of Gaussians: the one door to the splat formats."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gvr_core.dot_splat_io import read_dot_splat
from gvr_core.errors import SplatFormatError
from gvr_core.gaussians import Gaussians
from gvr_core.ply_io import read_ply, write_ply

__all__ = ["READERS", "read_dot_splat", "read_ply", "read_splat", "write_ply"]

READERS: dict[str, Callable[[Path | str], Gaussians]] = {
    ".ply": read_ply,
    ".splat": read_dot_splat,
}
"""Reader of each file name ending, in lower case."""


def read_splat(path: Path | str) -> Gaussians:
    """The Gaussians of a file, in the order of the file; the ending chooses the format.

    Args:
        path: A ``.ply`` or ``.splat`` file.

    Raises:
        SplatFormatError: if the ending is none of these, or the file is not as its format says.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in READERS:
        raise SplatFormatError(
            f"a file name that ends in {suffix!r}" if suffix else "a file name without ending",
            path=path,
            accepted=", ".join(READERS),
        )
    return READERS[suffix](path)
