"""Gaussians in PLY files: any SH degree, any column order, ascii or binary; written as binary.

Columns go by name, as inria's trainer names them
(https://github.com/graphdeco-inria/gaussian-splatting, ``scene/gaussian_model.py``): ``x y z``,
``f_dc_0..2`` and ``f_rest_*`` (channel-major spherical harmonics), ``opacity`` (logit),
``scale_0..2`` (log) and ``rot_0..3`` (wxyz). Other columns, such as normals, are ignored.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement
from scipy.special import expit, logit

from gvr_core.atomic import atomic_write
from gvr_core.errors import SplatFormatError
from gvr_core.gaussians import SH_COUNTS, FloatArray, Gaussians
from gvr_core.ply_header import VertexTable, read_vertex_table
from gvr_core.ply_rows import vertex_blocks
from gvr_core.splat_checks import open_splat, require, unit_quaternions

LOG_OF_ZERO = -104.0
"""Written for a scale or opacity of exactly 0: finite, and its exponential is 0 in float32."""

LOGIT_OF_ONE = 18.0
"""Written for an opacity of exactly 1: finite, and its sigmoid rounds to 1 in float32. The next
float32 below 1 has the logit 16.6."""

_MEANS = ("x", "y", "z")
_COLOURS = ("f_dc_0", "f_dc_1", "f_dc_2")
_SCALES = ("scale_0", "scale_1", "scale_2")
_QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")
_REQUIRED = (*_MEANS, *_COLOURS, "opacity", *_SCALES, *_QUATS)


def read_ply(path: Path | str) -> Gaussians:
    """The Gaussians of a PLY file, activated, in the order of the file.

    Exponentials and sigmoids are taken in float64 and rounded once. An infinite logit is an
    opacity of exactly 0 or 1: converters from formats with one byte of opacity write it.
    Memory is bounded by the size of the file, whatever the header says.

    Args:
        path: The file, ascii or binary of either byte order.

    Raises:
        SplatFormatError: if the file cannot be read, is no PLY file, holds fewer vertices than
            it says or none, lacks a column, has a number of ``f_rest`` columns that fits no
            degree, or has a value that is not finite, a scale too large for float32 or a
            quaternion of length zero.
    """
    path = Path(path)
    with open_splat(path) as (stream, size):
        table = read_vertex_table(stream, size, path)
        k = sh_count(table, path)
        n = table.count
        means, scales = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
        quats, opacities = np.empty((n, 4), np.float32), np.empty(n, np.float32)
        sh = np.empty((n, k, 3), np.float32)
        targets = {
            **{name: means[:, i] for i, name in enumerate(_MEANS)},
            **{name: sh[:, 0, i] for i, name in enumerate(_COLOURS)},
            **{f"f_rest_{i}": sh[:, 1 + i % (k - 1), i // (k - 1)] for i in range(3 * (k - 1))},
        }
        first = 0
        for block in vertex_blocks(stream, table, path):
            rows = slice(first, first + len(block))
            for name, target in targets.items():
                target[rows] = _finite(block, name, first, path)
            for i, name in enumerate(_SCALES):
                scales[rows, i] = _exponentials(block, name, first, path)
            raw = np.stack([_finite(block, name, first, path) for name in _QUATS], axis=1)
            quats[rows] = unit_quaternions(raw, path=path, column="rot_0..3", first_row=first)
            opacities[rows] = _sigmoids(block, first, path)
            first += len(block)
    return Gaussians(means, scales, quats, opacities, sh)


def write_ply(path: Path | str, gaussians: Gaussians) -> None:
    """Write Gaussians in inria's layout, binary little-endian, with normals of zero.

    Reading the file gives the same means and spherical harmonics to the last bit, and the same
    scales, opacities and rotations within the rounding of their stored form (logarithm, logit,
    unit quaternion) to float32; what was once read is written and read again unchanged.
    Opacities of exactly 0 and 1 and scales of exactly 0 have no finite logit or logarithm: they
    are written as :data:`LOG_OF_ZERO` and :data:`LOGIT_OF_ONE` and read back exactly.

    Args:
        path: The file to make or to replace; it appears whole or not at all.
        gaussians: N Gaussians.

    Raises:
        SplatFormatError: if an opacity is outside [0, 1], a scale is negative or a
            quaternion is zero.
        OSError: if the file cannot be written.
    """
    path = Path(path)
    opacities, scales, quats = gaussians.opacities, gaussians.scales, gaussians.quats
    check = partial(require, path=path, first_row=0, unit="Gaussian")
    check((opacities >= 0) & (opacities <= 1), opacities, column="opacity", accepted="0 to 1")
    check(scales.min(axis=1) >= 0, scales, column="scales", accepted="no negative number")
    check(np.abs(quats).max(axis=1) > 0, quats, column="quats", accepted="unit quaternions")
    rest = gaussians.sh[:, 1:].transpose(0, 2, 1).reshape(len(gaussians), -1)
    with np.errstate(divide="ignore"):
        log_scales = np.maximum(np.log(scales.astype(np.float64)), LOG_OF_ZERO)
        logits = np.clip(logit(opacities.astype(np.float64)), LOG_OF_ZERO, LOGIT_OF_ONE)
    columns: dict[str, NDArray[Any]] = {
        **dict(zip(_MEANS, gaussians.means.T, strict=True)),
        **dict.fromkeys(("nx", "ny", "nz"), np.zeros(1)),
        **dict(zip(_COLOURS, gaussians.sh[:, 0].T, strict=True)),
        **{f"f_rest_{i}": column for i, column in enumerate(rest.T)},
        "opacity": logits,
        **dict(zip(_SCALES, log_scales.T, strict=True)),
        **dict(zip(_QUATS, gaussians.quats.T, strict=True)),
    }
    table = np.empty(len(gaussians), [(name, "<f4") for name in columns])
    for name, column in columns.items():
        table[name] = column
    with atomic_write(path) as stream:
        PlyData([PlyElement.describe(table, "vertex")], byte_order="<").write(stream)


def sh_count(table: VertexTable, path: Path) -> int:
    """Spherical harmonics a channel (K), from the columns' names.

    Raises:
        SplatFormatError: if a column of a Gaussian is missing, or K fits no degree.
    """
    names = table.dtype.names or ()
    missing = [name for name in _REQUIRED if name not in names]
    if missing:
        packed = "packed_position" in names
        raise SplatFormatError(
            f"missing: {', '.join(missing)}" + (" (this is a compressed PLY)" if packed else ""),
            path=path,
            place="header, element vertex",
            accepted=f"at least the columns {', '.join(_REQUIRED)}",
        )
    rest = {name for name in names if re.fullmatch(r"f_rest_\d+", name)}
    accepted = [3 * (k - 1) for k in SH_COUNTS]
    if len(rest) not in accepted or rest != {f"f_rest_{i}" for i in range(len(rest))}:
        raise SplatFormatError(
            f"{len(rest)} columns named f_rest_* fit no degree of spherical harmonics",
            path=path,
            place="header, element vertex",
            accepted=f"{', '.join(map(str, accepted))} columns, numbered from 0",
        )
    return 1 + len(rest) // 3


def _finite(block: NDArray[Any], name: str, first: int, path: Path) -> FloatArray:
    """One column as float32."""
    with np.errstate(over="ignore", invalid="ignore"):
        values: FloatArray = block[name].astype(np.float32)
    require(
        np.isfinite(values),
        block[name],
        path=path,
        column=name,
        first_row=first,
        accepted="a finite number of 32 bits",
    )
    return values


def _exponentials(block: NDArray[Any], name: str, first: int, path: Path) -> FloatArray:
    """Scales from their logarithms."""
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        values: FloatArray = np.exp(block[name].astype(np.float64)).astype(np.float32)
    require(
        np.isfinite(values) & np.isfinite(block[name]),
        block[name],
        path=path,
        column=name,
        first_row=first,
        accepted="the finite logarithm of a scale, below 88.7",
    )
    return values


def _sigmoids(block: NDArray[Any], first: int, path: Path) -> FloatArray:
    """Opacities from their logits."""
    logits = block["opacity"].astype(np.float64)
    require(
        ~np.isnan(logits),
        logits,
        path=path,
        column="opacity",
        first_row=first,
        accepted="a logit: a number, or an infinity for an opacity of 0 or 1",
    )
    with np.errstate(over="ignore", under="ignore"):
        values: FloatArray = expit(logits).astype(np.float32)
    return values
