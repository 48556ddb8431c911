"""Small sets of Gaussians, and PLY files written by plyfile itself, for tests of the readers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement

from gvr_core.gaussians import SH_COUNTS, Gaussians

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
