"""What the renderer's benchmarks draw.

The scenes are surfaces, as captures are: half of the Gaussians lie on the six sides of a room of
6 x 4 x 3, half on twelve spheres in it, flat along the surface (a tenth as thick as wide), 0.6 of
their mean spacing wide with a log-normal spread of 0.5, opacities sigmoid(normal(1.5, 2)),
spherical harmonics of degree 3. The camera stands in a corner of the room and sees about 54 % of
them. More Gaussians are smaller ones, so that the picture stays the same.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.gaussians import Gaussians


def surface_scene(n: int, seed: int = 0) -> Gaussians:
    """The scene of the module's description.

    Args:
        n: Number of Gaussians.
        seed: Of the random numbers.
    """
    rng = np.random.default_rng(seed)
    room, on_walls = np.array([6.0, 4.0, 3.0]), n // 2
    centres, radii = (rng.random((12, 3)) - 0.5) * room * 0.7, rng.uniform(0.2, 0.5, 12)
    side = rng.integers(0, 6, on_walls)
    walls = (rng.random((on_walls, 3)) - 0.5) * room
    rows = np.arange(on_walls)
    walls[rows, side % 3] = np.where(side < 3, -0.5, 0.5) * room[side % 3]
    wall_normals = np.zeros((on_walls, 3))
    wall_normals[rows, side % 3] = 1
    ball = rng.integers(0, 12, n - on_walls)
    outward = rng.normal(size=(n - on_walls, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    means = np.concatenate([walls, centres[ball] + radii[ball, None] * outward])
    normals = np.concatenate([wall_normals, outward])

    area = 2 * (6 * 4 + 6 * 3 + 4 * 3) + 4 * np.pi * (radii**2).sum()
    scales = 0.6 * np.sqrt(area / n) * np.exp(rng.normal(0, 0.5, (n, 3)))
    scales[:, 2] *= 0.1
    quats = np.column_stack([1 + normals[:, 2], np.cross([0, 0, 1], normals)])
    quats[np.linalg.norm(quats, axis=1) < 1e-6] = (0, 1, 0, 0)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    sh = rng.normal(0, 0.1, (n, 16, 3))
    sh[:, 0] = rng.normal(0, 1, (n, 3))
    opacities = 1 / (1 + np.exp(-rng.normal(1.5, 2, n)))
    arrays = (np.asarray(a, np.float32) for a in (means, scales, quats, opacities, sh))
    return Gaussians(*arrays)


def corner_camera(width: int, height: int) -> Camera:
    pose = look_at([2.5, 1.2, 0.3], [-1, -0.5, -0.2], [0, 0, 1])
    return Camera(intrinsics(60, width, height), pose, width, height)


def seconds_of(work: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    start = clock()
    work()
    return clock() - start
