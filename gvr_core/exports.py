"""What an answer becomes on disk: the target alone, the scene without it, the scene with it dyed.

A PLY source is copied row by row: every column that it has, in its order and type, to the last
bit, also those that :class:`~gvr_core.gaussians.Gaussians` has no place for. Going through
Gaussians would round logits, logarithms and quaternions, and lose normals. Other sources are
written in inria's layout by :func:`gvr_core.ply_io.write_ply`.

Files are binary little-endian PLY whatever the source is, and appear whole or not at all.
Elements other than the vertices are left out: faces and the like count rows that are gone.
"""

from __future__ import annotations

import re
from collections.abc import Generator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement

from gvr_core.atomic import atomic_write
from gvr_core.errors import ConfigError, SplatFormatError
from gvr_core.gaussians import SH_C0, BoolArray, Gaussians
from gvr_core.ply_header import VertexTable, read_vertex_table
from gvr_core.ply_io import sh_count, write_ply
from gvr_core.ply_rows import vertex_blocks
from gvr_core.splat_checks import open_splat
from gvr_core.splat_io import read_splat

EXPORTS = {
    "target": "the target alone",
    "without": "the scene without the target",
    "dyed": "the scene with the target in one colour",
}
"""Kind of export -> what its PLY holds."""

RGB = tuple[float, float, float]
RED: RGB = (1.0, 0.0, 0.0)
"""The paper's dye."""

Source = Path | str | Gaussians
"""A .ply or .splat file, or Gaussians in memory."""


def write_target(path: Path | str, source: Source, flags: BoolArray) -> None:
    """Write the flagged Gaussians alone, in the order of the source.

    Args:
        path: The PLY to make or to replace.
        source: The scene: N Gaussians.
        flags: (N,) bool, I_tar.

    Raises:
        SplatFormatError: if the flags do not belong to the source, no flag is set, the source
            cannot be read, or it is the file to be written.
        OSError: if the file cannot be written.
    """
    _write(Path(path), source, flags, flags)


def write_without(path: Path | str, source: Source, flags: BoolArray) -> None:
    """Write the Gaussians that are not flagged, in the order of the source.

    Args:
        path: The PLY to make or to replace.
        source: The scene: N Gaussians.
        flags: (N,) bool, I_tar.

    Raises:
        SplatFormatError: as :func:`write_target`, and if every flag is set.
        OSError: if the file cannot be written.
    """
    _write(Path(path), source, flags, ~np.asarray(flags, np.bool_))


def write_dyed(path: Path | str, source: Source, flags: BoolArray, rgb: RGB = RED) -> None:
    """Write all Gaussians, the flagged ones in one colour from every direction.

    Only the flagged rows change, and of these only the spherical harmonics: the constant one
    becomes (rgb - 1/2) / Y_00, the others 0.

    Args:
        path: The PLY to make or to replace.
        source: The scene: N Gaussians.
        flags: (N,) bool, I_tar.
        rgb: The colour, channels in [0, 1].

    Raises:
        SplatFormatError: as :func:`write_target`, save that no flag has to be set.
        OSError: if the file cannot be written.
    """
    _write(Path(path), source, flags, np.ones_like(flags, np.bool_), rgb)


def write_indices(path: Path | str, flags: BoolArray) -> None:
    """Write the rows that are flagged as .npy: (n,) int64, ascending, counted from 0.

    The flags of N Gaussians come back with ``flags = np.zeros(N, bool);
    flags[np.load(path)] = True``.

    Args:
        path: The file to make or to replace.
        flags: (N,) bool.

    Raises:
        OSError: if the file cannot be written.
    """
    with atomic_write(Path(path)) as stream:
        np.save(stream, np.flatnonzero(flags).astype(np.int64), allow_pickle=False)


def parse_colour(text: str) -> RGB:
    """The colour of a text such as ``#ff8000``, channels in [0, 1].

    Args:
        text: Red, green and blue as two hexadecimal digits each; a ``#`` before them is optional.

    Raises:
        ConfigError: for anything else.
    """
    match = re.fullmatch(r"#?([0-9a-fA-F]{2})([0-9a-fA-F]{2})([0-9a-fA-F]{2})", text.strip())
    if match is None:
        raise ConfigError(
            f"the colour {text[:60]!r}", accepted="six hexadecimal digits, such as #ff0000 for red"
        )
    red, green, blue = (int(digits, 16) / 255 for digits in match.groups())
    return red, green, blue


def _write(
    path: Path, source: Source, flags: BoolArray, keep: BoolArray, rgb: RGB | None = None
) -> None:
    """The kept rows of a source; where a colour is given, the flagged ones dyed."""
    if not isinstance(source, Gaussians):
        source = Path(source)
        if path.exists() and source.exists() and path.samefile(source):
            raise SplatFormatError(
                "the scene would be replaced by its export", path=path, accepted="another name"
            )
        if source.suffix.lower() == ".ply":
            _copy_rows(path, source, flags, keep, rgb)
            return
        gaussians = read_splat(source)
    else:
        gaussians = source
    _check(flags, keep, len(gaussians), source if isinstance(source, Path) else None)
    if rgb is not None:
        gaussians = gaussians.dyed(flags, rgb)
    write_ply(path, gaussians.subset(keep))


def _copy_rows(
    path: Path, source: Path, flags: BoolArray, keep: BoolArray, rgb: RGB | None
) -> None:
    """Rows of a PLY file as they are, a block at a time: no second copy of a scene in memory."""
    with closing(_parts(source, flags, keep, rgb)) as parts:
        header = next(parts)  # what cannot be used is refused before a file is begun
        with atomic_write(path) as stream:
            stream.write(header)
            stream.writelines(parts)


def _parts(
    source: Path, flags: BoolArray, keep: BoolArray, rgb: RGB | None
) -> Generator[bytes, None, None]:
    """The header of an export, then its rows.

    A generator, for errors in writing to be told from those in reading: the former do not pass
    through here, where they would be blamed on the source.
    """
    with open_splat(source) as (stream, size):
        table = read_vertex_table(stream, size, source)
        sh_count(table, source)  # refuses what is no set of Gaussians, such as a compressed PLY
        _check(flags, keep, table.count, source)
        dtype = table.dtype.newbyteorder("<")
        yield _header(table, dtype, int(keep.sum()))
        first = 0
        for block in vertex_blocks(stream, table, source):
            rows = slice(first, first + len(block))
            kept = block[keep[rows]].astype(dtype)
            if rgb is not None:
                _dye(kept, flags[rows][keep[rows]], rgb)
            yield kept.tobytes()
            first += len(block)


def _header(table: VertexTable, dtype: np.dtype[Any], count: int) -> bytes:
    """The header of ``count`` rows, with the comments of the source."""
    # One row seen ``count`` times takes no memory, and plyfile counts it right.
    rows = np.broadcast_to(np.zeros(1, dtype), count)
    element = PlyElement.describe(rows, "vertex")
    ply = PlyData([element], byte_order="<", comments=list(table.comments))
    return f"{ply.header}\n".encode("ascii")


def _dye(rows: NDArray[Any], flags: BoolArray, rgb: RGB) -> None:
    """Give flagged rows of a PLY one colour."""
    for name in rows.dtype.names or ():
        if re.fullmatch(r"f_rest_\d+", name):
            rows[name][flags] = 0
    for i, channel in enumerate(rgb):
        rows[f"f_dc_{i}"][flags] = (np.float32(channel) - np.float32(0.5)) / np.float32(SH_C0)


def _check(flags: BoolArray, keep: BoolArray, n: int, path: Path | None) -> None:
    """Refuse flags of another scene, and files without a Gaussian, which nobody can read."""
    if flags.shape != (n,) or flags.dtype != np.bool_:
        raise SplatFormatError(
            f"the flags are {flags.dtype} of shape {flags.shape}",
            path=path,
            accepted=f"bool of shape ({n},), one for each Gaussian of the scene",
        )
    if not keep.any():
        raise SplatFormatError(
            "no Gaussian would be left", path=path, accepted="one Gaussian or more"
        )
