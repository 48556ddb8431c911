"""Random Gaussians and cameras that the tests of the renderer share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.gaussians import SH_COUNTS, Gaussians


def float32(array: ArrayLike) -> NDArray[np.float32]:
    return np.ascontiguousarray(array, dtype=np.float32)


def gaussians_of(
    means: ArrayLike,
    scales: ArrayLike,
    opacities: ArrayLike,
    rgb: ArrayLike,
    quats: ArrayLike | None = None,
) -> Gaussians:
    """Gaussians with flat colours, unrotated unless told."""
    means = float32(means)
    n = len(means)
    turned = np.tile([1.0, 0, 0, 0], (n, 1)) if quats is None else quats
    scales = np.broadcast_to(float32(scales), (n, 3))
    dark = np.zeros((n, 1, 3), np.float32)
    bare = Gaussians(means, float32(scales), float32(turned), float32(opacities), dark)
    return bare.recoloured(float32(rgb))


def cloud(
    seed: int, n: int, degree: int = 0, size: float = 1.0, centre: ArrayLike = 0
) -> Gaussians:
    """A cloud around a point: needles and discs, half of it very opaque or very faint.

    Scales spread over a factor of 400 around ``0.02 size``; some opacities are exactly 1.
    """
    rng = np.random.default_rng(seed)
    opacities = rng.beta(0.7, 0.7, n)
    opacities[: n // 20] = 1
    opacities[n // 20 : n // 10] = rng.uniform(0.99, 1, n // 10 - n // 20)
    return Gaussians(
        float32(rng.normal(0, 1.5, (n, 3)) + np.asarray(centre)),
        float32(size * np.exp(rng.normal(-4, 1.5, (n, 3)))),
        float32(rng.normal(size=(n, 4)) * rng.uniform(0.5, 2, (n, 1))),
        float32(opacities),
        float32(rng.normal(0, 0.4, (n, SH_COUNTS[degree], 3))),
    )


def camera(
    width: int = 150,
    height: int = 101,
    eye: ArrayLike = (1.2, 0.5, 0.3),
    target: ArrayLike = (-0.2, -0.3, 0.0),
    fov: float = 70.0,
    offset: tuple[float, float] = (0.0, 0.0),
    aspect: float = 1.0,
) -> Camera:
    """A camera; sizes that are no multiples of a tile unless told.

    Args:
        width: Pixels.
        height: Pixels.
        eye: Where it is.
        target: Where it looks.
        fov: Degrees, horizontal.
        offset: Of the principal point from the middle, pixels.
        aspect: fy / fx.
    """
    K = intrinsics(fov, width, height)
    K[:2, 2] += offset
    K[1, 1] *= aspect
    return Camera(K, look_at(eye, target, (0, 0, 1)), width, height)


def front_camera(width: int = 32, height: int = 32, focal: float = 40.0) -> Camera:
    """A camera in the origin that looks along +z, its axis through the centre of a pixel."""
    K = np.array([[focal, 0, width // 2 + 0.5], [0, focal, height // 2 + 0.5], [0, 0, 1]])
    return Camera(K, np.eye(4), width, height)


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """The blocks of the reference are small: more threads would only wait for each other."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
