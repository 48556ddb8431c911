"""Small sets of Gaussians, and PLY files written by plyfile itself, for tests of the readers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.lib import recfunctions
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement

from gvr_core.gaussians import SH_COUNTS, Gaussians

STANDARD = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
SHAPE = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]

FIELDS = ("means", "scales", "quats", "opacities", "sh")


def some_gaussians(n: int = 20, degree: int = 3, seed: int = 0) -> Gaussians:
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(n, 4))
    arrays = (
        rng.normal(size=(n, 3)),
        np.exp(rng.normal(-4, 2, size=(n, 3))),
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        rng.uniform(0.001, 0.999, size=n),
        rng.normal(size=(n, SH_COUNTS[degree], 3)),
    )
    return Gaussians(*(array.astype(np.float32) for array in arrays))


def same(a: Gaussians, b: Gaussians) -> bool:
    return all(np.array_equal(getattr(a, f), getattr(b, f)) for f in FIELDS)


def vertex_of(path: Path) -> NDArray:
    """The vertices as plyfile reads them: a structured array."""
    return np.array(PlyData.read(path)["vertex"].data)


def save_vertex(
    path: Path, vertex: NDArray, *, text: bool = False, byte_order: str = "<", others: Sequence = ()
) -> Path:
    PlyData(
        [*others, PlyElement.describe(vertex, "vertex")], text=text, byte_order=byte_order
    ).write(path)
    return path


def columns(degree: int) -> list[str]:
    return [*STANDARD, *(f"f_rest_{i}" for i in range(3 * (SH_COUNTS[degree] - 1))), *SHAPE]


def as_trained(n: int, degree: int, seed: int = 0) -> NDArray:
    """Vertices as an optimiser leaves them: quaternions of any length, large logits, normals."""
    rng = np.random.default_rng(seed)
    vertex = np.empty(n, [(name, "<f4") for name in columns(degree)])
    for name in columns(degree):
        vertex[name] = rng.normal(scale=8 if name == "opacity" else 1, size=n)
    return vertex


def some_flags(n: int, seed: int = 0) -> NDArray[np.bool_]:
    flags = np.random.default_rng(seed).random(n) < 0.4
    flags[:2] = True, False
    return flags


def bits(rows: NDArray) -> bytes:
    """Packed rows, for a comparison that tells -0 from 0 and knows NaN."""
    return recfunctions.repack_fields(rows).tobytes()
