"""A small synthetic scene made on the spot: two boxes on a plane, cameras around them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.gaussians import SH_C0, Gaussians
from gvr_core.scene import Scene, View

OBJECTS = ("red box", "blue box")
UP = np.array([0.0, 0.0, 1.0])


def flat_gaussians(
    means: NDArray[np.float64], rgb: tuple[float, float, float], sigma: float
) -> Gaussians:
    """Round, nearly opaque Gaussians of one size and colour."""
    n = len(means)
    sh = ((np.array(rgb) - 0.5) / SH_C0).astype(np.float32)
    quats = np.zeros((n, 4), np.float32)
    quats[:, 0] = 1
    return Gaussians(
        means.astype(np.float32),
        np.full((n, 3), sigma, np.float32),
        quats,
        np.full(n, 0.95, np.float32),
        np.tile(sh, (n, 1, 1)).astype(np.float32),
    )


def box(centre: tuple[float, float, float], side: float, steps: int = 14) -> NDArray[np.float64]:
    """(n, 3) points on a regular grid that fills a cube."""
    ticks = np.linspace(-side / 2, side / 2, steps)
    grid = np.stack(np.meshgrid(ticks, ticks, ticks), axis=-1).reshape(-1, 3)
    return grid + np.array(centre)


def two_boxes(n_views: int = 8, width: int = 96, height: int = 72) -> tuple[Scene, NDArray]:
    """The scene, and the label of each Gaussian (index into OBJECTS, -1 for the plane)."""
    ticks = np.linspace(-3, 3, 60)
    plane = np.stack(np.meshgrid(ticks, ticks, [0.0]), axis=-1).reshape(-1, 3)
    parts = [
        flat_gaussians(box((-1.0, 0.0, 0.45), 0.8), (0.9, 0.1, 0.1), 0.05),
        flat_gaussians(box((1.0, 0.4, 0.35), 0.6), (0.1, 0.1, 0.9), 0.04),
        flat_gaussians(plane, (0.5, 0.5, 0.5), 0.08),
    ]
    labels = np.concatenate(
        [np.full(len(part), label) for part, label in zip(parts, (0, 1, -1), strict=True)]
    ).astype(np.int16)
    K = intrinsics(60, width, height)
    views = []
    for i, yaw in enumerate(2 * np.pi * np.arange(n_views) / n_views):
        eye = np.array([4 * np.cos(yaw), 4 * np.sin(yaw), 2.0])
        views.append(View(f"v{i:02d}", Camera(K, look_at(eye, (0, 0, 0.3), UP), width, height)))
    return Scene("test", "two-boxes", Gaussians.concatenate(parts), tuple(views)), labels
