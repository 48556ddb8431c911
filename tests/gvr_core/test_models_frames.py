"""Ray-traced frames with known masks, for the tests of the models; and tests that they are right.

Boxes with photographs on all faces stand on gravel before a brick wall. World frame: z up, ground
z = 0, wall at y = 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import skimage.data
from numpy.typing import NDArray

from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.models.base import Frame

GROUND, WALL, NOTHING = -2, -3, -1

PHOTOGRAPHS = {
    "cat": skimage.data.chelsea,
    "coffee": skimage.data.coffee,
    "rocket": skimage.data.rocket,
    "astronaut": skimage.data.astronaut,
}


@dataclass(frozen=True)
class Box:
    """A box on the ground."""

    photograph: str
    centre: tuple[float, float]
    size: tuple[float, float, float]


BOXES = (
    Box("cat", (-1.0, 0.2), (0.7, 0.3, 0.5)),
    Box("coffee", (0.2, -0.3), (0.5, 0.5, 0.6)),
    Box("rocket", (1.2, 0.6), (0.5, 0.1, 1.0)),
    Box("astronaut", (0.3, 1.2), (0.6, 0.4, 0.8)),
)


def camera_at(
    eye: tuple[float, float, float],
    target: tuple[float, float, float] = (0.1, 0.3, 0.3),
    size: tuple[int, int] = (320, 240),
) -> Camera:
    """A camera with a 55 degree field of view."""
    return Camera(intrinsics(55, *size), look_at(eye, target, (0, 0, 1)), *size)


FRONT = camera_at((0, -3.5, 1.6))
LEFT = camera_at((-3, -2.5, 1.2))
RIGHT = camera_at((3, -2, 2.2))


def above(box: Box) -> Camera:
    """A camera that looks straight down at a box."""
    x, y = box.centre
    return camera_at((x, y, box.size[2] + 2.2), (x, y, 0))


def trace(
    camera: Camera,
    boxes: tuple[Box, ...] = BOXES,
    *,
    room: bool = True,
    scale: float = 1.0,
    depth_noise: float = 0.0,
) -> tuple[Frame, NDArray[np.int64]]:
    """A frame, and for each pixel the index of the box it shows (or GROUND, WALL, NOTHING).

    Args:
        camera: Where from.
        boxes: What stands on the ground.
        room: Whether the ground and the wall are there.
        scale: Depths are given in units this much smaller.
        depth_noise: Relative standard deviation of independent noise.
    """
    height, width = camera.height, camera.width
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    local = np.stack(
        [(u - camera.K[0, 2]) / camera.K[0, 0], (v - camera.K[1, 2]) / camera.K[1, 1], u * 0 + 1],
        axis=-1,
    )
    # Rays have z = 1 in the camera's frame, so that the ray parameter is the depth.
    rays = (local @ camera.world_to_camera[:3, :3]).reshape(-1, 3)
    eye = camera.position
    depth = np.full(height * width, np.inf)
    rgb = np.zeros((height * width, 3))
    shows = np.full(height * width, NOTHING)

    def draw(t: NDArray, hit: NDArray, s: NDArray, r: NDArray, picture: NDArray, what: int) -> None:
        seen = hit & (t > 1e-6) & (t < depth)
        depth[seen], shows[seen] = t[seen], what
        rows = np.clip((r[seen] % 1 * picture.shape[0]).astype(int), 0, picture.shape[0] - 1)
        columns = np.clip((s[seen] % 1 * picture.shape[1]).astype(int), 0, picture.shape[1] - 1)
        colour = picture[rows, columns] / 255
        rgb[seen] = colour if colour.ndim == 2 else colour[:, None]

    with np.errstate(divide="ignore", invalid="ignore"):
        if room:
            t = -eye[2] / rays[:, 2]
            p = eye + t[:, None] * rays
            on = (np.abs(p[:, 0]) < 6) & (np.abs(p[:, 1]) < 6) & (p[:, 1] < 3)
            draw(t, on, p[:, 0] / 1.5, p[:, 1] / 1.5, skimage.data.gravel(), GROUND)
            t = (3 - eye[1]) / rays[:, 1]
            p = eye + t[:, None] * rays
            on = (np.abs(p[:, 0]) < 6) & (p[:, 2] > 0) & (p[:, 2] < 5)
            draw(t, on, p[:, 0] / 2, -p[:, 2] / 2, skimage.data.brick(), WALL)
        for index, box in enumerate(boxes):
            size = np.array(box.size)
            low = np.array([box.centre[0] - size[0] / 2, box.centre[1] - size[1] / 2, 0.0])
            first, second = (low - eye) / rays, (low + size - eye) / rays
            enter, leave = np.minimum(first, second), np.maximum(first, second).min(axis=1)
            axis, t = enter.argmax(axis=1), enter.max(axis=1)
            q = np.clip((eye + t[:, None] * rays - low) / size, 0, 1 - 1e-9)
            across = np.where(axis == 0, q[:, 1], q[:, 0])
            down = np.where(axis == 2, q[:, 1], 1 - q[:, 2])
            draw(t, t <= leave, across, down, PHOTOGRAPHS[box.photograph](), index)
    drawn = np.isfinite(depth)
    depth = np.where(drawn, depth * scale, 0)
    depth *= 1 + depth_noise * np.random.default_rng(0).standard_normal(depth.shape)
    shape = (height, width)
    frame = Frame(
        rgb.reshape(*shape, 3).astype(np.float32),
        depth.reshape(shape).astype(np.float32),
        camera,
        drawn.reshape(shape).astype(np.float32),
    )
    return frame, shows.reshape(shape)


def iou(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    """Intersection over union of two masks."""
    return float((a & b).sum() / max(1, (a | b).sum()))


def middle(mask: NDArray[np.bool_]) -> tuple[float, float]:
    """The pixel of a mask (as its centre's x, y) that is nearest to the mask's median."""
    rows, columns = np.nonzero(mask)
    nearest = np.argmin((rows - np.median(rows)) ** 2 + (columns - np.median(columns)) ** 2)
    return float(columns[nearest]) + 0.5, float(rows[nearest]) + 0.5


@pytest.mark.parametrize("camera", [FRONT, LEFT, RIGHT, above(BOXES[0])])
def test_depth_and_labels_fit_the_boxes(camera: Camera) -> None:
    frame, shows = trace(camera)
    v, u = np.nonzero(frame.depth)
    points = camera.unproject(np.stack([u, v], axis=1) + 0.5, frame.depth[v, u])
    labels = shows[v, u]
    assert np.abs(points[labels == GROUND, 2]).max() < 1e-5
    for index, box in enumerate(BOXES):
        inside = points[labels == index]
        if len(inside) == 0:
            continue
        offset = np.abs(inside[:, :2] - box.centre) * 2 / box.size[:2]
        assert offset.max() < 1 + 1e-4 and offset.max() > 0.99
        assert inside[:, 2].min() > -1e-5 and inside[:, 2].max() < box.size[2] + 1e-5


def test_an_empty_world_shows_nothing() -> None:
    frame, shows = trace(FRONT, (), room=False)
    assert (shows == NOTHING).all()
    assert not frame.depth.any() and frame.alpha is not None and not frame.alpha.any()
