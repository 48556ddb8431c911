"""Random pictures for the protocols: noise, blobs, blocks, plateaus, nothing."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from gvr_core.protocols.base import Box, ViewPrediction, ViewTruth

SIZES = ((1, 1), (1, 9), (8, 1), (2, 2), (7, 5), (31, 29), (29, 31), (40, 64))
"""Heights and widths, about the sides of the windows."""
FULL = (731, 988)
"""Height and width of the LERF pictures."""


def soft_map(rng: np.random.Generator, size: tuple[int, int]) -> np.ndarray:
    """One of several kinds of map (H, W) float32 in [0, 1]."""
    kind = rng.integers(6)
    if kind == 0:
        soft = np.zeros(size)
    elif kind == 1:
        soft = rng.random(size)
    elif kind == 2:
        soft = rng.integers(0, 256, size) / 255
    elif kind == 3:
        soft = mask(rng, size).astype(np.float64)
    elif kind == 4:
        soft = np.full(size, rng.choice([0.3, 0.5, 1.0]))
    else:
        soft = blobs(rng, size)
    return soft.astype(np.float32)


def blobs(
    rng: np.random.Generator, size: tuple[int, int], radius: float | None = None
) -> np.ndarray:
    """Smooth noise over all of [0, 1]; its blobs are about as wide as the radius, in pixels."""
    smooth = ndimage.gaussian_filter(rng.random(size), radius or rng.uniform(1, 6))
    smooth -= smooth.min()
    return smooth / max(smooth.max(), 1e-6)


def mask(rng: np.random.Generator, size: tuple[int, int]) -> np.ndarray:
    """A mask (H, W) bool: noise, a few rectangles, everything or nothing."""
    kind = rng.integers(5)
    if kind == 0:
        return np.zeros(size, np.bool_)
    if kind == 1:
        return np.ones(size, np.bool_)
    if kind == 2:
        return rng.random(size) > rng.random()
    picture = np.zeros(size, np.bool_)
    for _ in range(rng.integers(1, 4)):
        rows, columns = (np.sort(rng.integers(0, length + 1, 2)) for length in size)
        picture[rows[0] : rows[1], columns[0] : columns[1]] = True
    return picture


def boxes(rng: np.random.Generator, size: tuple[int, int]) -> tuple[Box, ...]:
    """Up to three boxes with corners in any order, some of them between pixels."""
    height, width = size
    corners = rng.uniform(-2, 2, (rng.integers(0, 4), 4)) + rng.uniform(0, 1, 4) * [
        width,
        height,
        width,
        height,
    ]
    if rng.random() < 0.5:
        corners = np.round(corners)
    return tuple((float(a), float(b), float(c), float(d)) for a, b, c, d in corners)


def pair(
    rng: np.random.Generator, size: tuple[int, int], levels: int = 0
) -> tuple[ViewPrediction, ViewTruth]:
    """A prediction and a truth that may have nothing to do with each other, or much.

    Args:
        rng: Where the chances come from.
        size: Height and width.
        levels: Number of relevancy maps.
    """
    truth = mask(rng, size)
    soft = soft_map(rng, size)
    if rng.random() < 0.4:  # often near the truth, so that overlaps are of all sizes
        soft = np.where(rng.random(size) < 0.9, truth, soft).astype(np.float32)
    missing = bool(rng.random() < 0.1)
    pixel = None if rng.random() < 0.3 else tuple(rng.uniform(-1, 1 + max(size), 2).tolist())
    prediction = ViewPrediction(
        soft=np.zeros_like(soft) if missing else soft,
        isolated=None if missing or rng.random() < 0.5 else soft_map(rng, size),
        relevancy=relevancy(rng, size, levels) if levels and not missing else None,
        pixel=pixel,
        missing=missing,
    )
    return prediction, ViewTruth(truth, boxes(rng, size))


def relevancy(rng: np.random.Generator, size: tuple[int, int], levels: int) -> np.ndarray:
    """Relevancy maps (L, H, W) float32 of different strength."""
    maps = [soft_map(rng, size) * rng.uniform(0.2, 1) for _ in range(levels)]
    return np.stack(maps).astype(np.float32)


def grey(values: np.ndarray) -> np.ndarray:
    """A given picture's grey values 0 .. 255 as a soft prediction."""
    return values.astype(np.float32) / np.float32(255)
