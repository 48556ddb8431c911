"""Where a gallery's boxes and cards stand: drawn by seed, apart from each other, all in sight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gvr_core.cameras import Camera

Float64Array = NDArray[np.float64]

TABLE = (0.95, 0.65)
"""Half the width (x) and half the depth (y) of the part of the table where things may stand;
more where they would not fit."""
GAP = 0.03
"""Least distance between the circles around two things."""
CANDIDATES = 600
"""Arrangements that are drawn for a scene; the one with the least occlusion is taken."""


@dataclass(frozen=True)
class Item:
    """One thing on the table."""

    name: str
    """The object it shows."""
    size: tuple[float, float, float]
    """Width, depth and height of the thing before it is turned."""
    lean_degrees: float
    """How far it leans back: 0 stands upright, 90 lies on its back."""
    yaw_degrees: float
    """Turn about the vertical; 0 faces the front."""
    boxed: bool
    """True for a box with the picture all around, False for a thin card."""

    @property
    def rotation(self) -> Float64Array:
        """(3, 3) from the thing's own frame to the world's: lean, then turn."""
        # about x, a positive angle would bring the top towards the front
        angles = [self.yaw_degrees, -self.lean_degrees]
        return np.asarray(Rotation.from_euler("ZX", angles, degrees=True).as_matrix())

    def corners(self) -> Float64Array:
        """(8, 3) corners of the turned thing, standing on the ground, centred over the origin."""
        w, d, h = self.size
        unit_cube = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0, 1)])
        turned: Float64Array = unit_cube * (w, d, h) @ self.rotation.T
        middle = (turned.min(axis=0) + turned.max(axis=0)) / 2
        standing: Float64Array = turned - np.array([middle[0], middle[1], turned[:, 2].min()])
        return standing


def arrange(
    rng: np.random.Generator, items: Sequence[Item], cameras: Sequence[Camera]
) -> Float64Array:
    """Places for things on the table: no two touch, all in sight where that can be.

    Args:
        rng: Where the candidates come from.
        items: The things, largest first, so that the small ones fill the gaps.
        cameras: The views in which they should be seen.

    Returns:
        (n, 2) position x, y of each thing's middle.
    """
    boxes = np.stack([item.corners() for item in items])
    radii = np.linalg.norm(boxes[..., :2], axis=-1).max(axis=1)
    best, least, failed = np.zeros((len(items), 2)), np.inf, 0
    for _ in range(CANDIDATES):
        places = None
        while places is None:
            # large things may need more room than there is: it grows until they fit
            places = _scatter(rng, radii, np.asarray(TABLE) * (1 + failed / 1000))
            failed += places is None
        cost = _hidden(boxes, places, cameras)
        if cost < least:
            best, least = places, cost
    return best


def _scatter(
    rng: np.random.Generator, radii: Float64Array, table: Float64Array
) -> Float64Array | None:
    """(n, 2) random places on the table at which circles do not touch, or None."""
    places = np.zeros((len(radii), 2))
    for i, radius in enumerate(radii):
        room = np.maximum(table - radius, 0)
        for _ in range(30):
            place = rng.uniform(-room, room)
            apart = np.linalg.norm(places[:i] - place, axis=1)
            if (apart > radii[:i] + radius + GAP).all():
                places[i] = place
                break
        else:
            return None
    return places


def _hidden(boxes: Float64Array, places: Float64Array, cameras: Sequence[Camera]) -> float:
    """How much of the things' picture rectangles is covered or cut off, over cameras and things.

    Half of the sum is the worst thing's share, so that none is hidden for the sake of the rest.

    Args:
        boxes: (n, 8, 3) corners over the origin.
        places: (n, 2) where the things stand.
        cameras: The views.
    """
    standing = boxes.copy()
    standing[..., :2] += places[:, None]
    shares = np.zeros(len(boxes))
    for camera in cameras:
        pixels, depth = camera.project(standing)
        seen = np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)
        size = _area(seen)
        outside = size - _area(np.clip(seen, 0, [camera.width, camera.height] * 2))
        low = np.maximum(seen[:, None, :2], seen[None, :, :2])
        high = np.minimum(seen[:, None, 2:], seen[None, :, 2:])
        overlap = _area(np.concatenate([low, np.maximum(low, high)], axis=-1))
        middle = depth.mean(axis=1)
        behind = middle[:, None] > middle[None, :]
        shares += ((overlap * behind).sum(axis=1) + outside) / size
    return float(shares.sum() / 2 + shares.max() / 2 * len(boxes))


def _area(rectangles: Float64Array) -> Float64Array:
    """Area of rectangles (..., 4) x0 y0 x1 y1."""
    sides = rectangles[..., 2:] - rectangles[..., :2]
    return np.asarray(sides[..., 0] * sides[..., 1])
