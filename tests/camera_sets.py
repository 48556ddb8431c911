"""Cameras in random places, for tests of the readers and writers of camera files."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from gvr_core.cameras import Camera


def some_cameras(n: int = 6, seed: int = 0, *, centred: bool = False) -> list[tuple[str, Camera]]:
    """Names (some in a folder) and cameras, in name order; two kinds of intrinsics."""
    rng = np.random.default_rng(seed)
    images = []
    for i in range(n):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.random(rng=rng).as_matrix()
        pose[:3, 3] = rng.normal(size=3) * 10
        width, height = (640, 480) if i % 2 else (333, 250)
        cx, cy = (width / 2, height / 2) if centred else (width / 2 + 1.25, height / 2 - 0.5)
        K = np.array([[500.0 + width, 0, cx], [0, 501.5 + height, cy], [0, 0, 1]])
        name = f"left/view_{i:02d}.jpg" if i < n // 2 else f"view_{i:02d}.jpg"
        images.append((name, Camera(K, pose, width, height)))
    return images


def largest_difference(a: list[tuple[str, Camera]], b: list[tuple[str, Camera]]) -> float:
    """Largest difference of a pose or intrinsic number between two lists of equal names."""
    assert [(name, c.width, c.height) for name, c in a] == [
        (name, c.width, c.height) for name, c in b
    ]
    return max(
        max(np.abs(x.world_to_camera - y.world_to_camera).max(), np.abs(x.K - y.K).max())
        for (_, x), (_, y) in zip(a, b, strict=True)
    )
