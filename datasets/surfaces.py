"""Textured surfaces made of flat Gaussians: rectangles, and boxes with a picture on each face."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from gvr_core.gaussians import SH_C0, Gaussians

RGB8 = NDArray[np.uint8]

SPREAD = 0.65
"""Standard deviation of a Gaussian in its surface, in distances to the next one: wide enough to
leave no gap between four neighbours, narrow enough to keep the picture sharp."""
THICKNESS = 0.03
"""Standard deviation across the surface, in the same unit."""
OPACITY = 0.98


def rectangle(
    corner: ArrayLike, right: ArrayLike, down: ArrayLike, texture: RGB8, pitch: float
) -> Gaussians:
    """A textured rectangle: one flat Gaussian for each cell of a grid.

    Args:
        corner: (3,) where the texture's top left corner lies.
        right: (3,) vector along the texture's upper edge.
        down: (3,) vector along its left edge, perpendicular to ``right``.
        texture: (h, w, 3) uint8.
        pitch: Wanted distance between neighbouring Gaussians, in the unit of the vectors.

    Returns:
        Gaussians without view-dependent colour.
    """
    origin, u, v = (np.asarray(a, np.float64) for a in (corner, right, down))
    width, height = float(np.linalg.norm(u)), float(np.linalg.norm(v))
    columns, rows = max(2, round(width / pitch)), max(2, round(height / pitch))
    s, t = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    means = origin + s.reshape(-1, 1) * u + t.reshape(-1, 1) * v
    across, along = width / columns, height / rows
    scale = np.array([SPREAD * across, SPREAD * along, THICKNESS * min(across, along)])
    axes = np.stack([u / width, v / height, np.cross(u, v) / (width * height)], axis=1)
    quat = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    picture = Image.fromarray(texture).resize((columns, rows), Image.Resampling.BOX)
    rgb = np.asarray(picture, np.float32).reshape(-1, 1, 3) / np.float32(255)
    n = len(means)
    return Gaussians(
        means.astype(np.float32),
        np.tile(scale.astype(np.float32), (n, 1)),
        np.tile(quat.astype(np.float32), (n, 1)),
        np.full(n, OPACITY, np.float32),
        ((rgb - np.float32(0.5)) / np.float32(SH_C0)).astype(np.float32),
    )


def box(size: tuple[float, float, float], faces: RGB8, rim: RGB8 | None, pitch: float) -> Gaussians:
    """A box on the ground, its middle over the origin, its front towards -y; z is up.

    Args:
        size: Width (x), depth (y) and height (z).
        faces: (h, w, 3) uint8 picture for the front and the back, cut to their shape. Without a
            ``rim`` the left, the right and the top show it as well.
        rim: (h, w, 3) uint8 for the left, the right and the top; a thin card has a plain one.
        pitch: Distance between neighbouring Gaussians.

    Returns:
        Gaussians of the five faces that can be seen; nothing is drawn underneath.
    """
    w, d, h = size
    other = faces if rim is None else rim
    x, y, z = np.eye(3)
    walls = (
        ((-w / 2, -d / 2, h), w * x, -h * z, faces, 1.0),
        ((w / 2, -d / 2, h), d * y, -h * z, other, 0.86),
        ((w / 2, d / 2, h), -w * x, -h * z, faces, 0.94),
        ((-w / 2, d / 2, h), -d * y, -h * z, other, 0.80),
        ((-w / 2, d / 2, h), w * x, -d * y, other, 1.06),
    )
    parts = []
    for corner, right, down, texture, light in walls:
        fitted = crop_to_aspect(texture, float(np.linalg.norm(right) / np.linalg.norm(down)))
        lit = np.clip(np.rint(fitted * light), 0, 255).astype(np.uint8)
        parts.append(rectangle(corner, right, down, lit, pitch))
    return Gaussians.concatenate(parts)


def crop_to_aspect(picture: RGB8, aspect: float) -> RGB8:
    """The largest middle part of a picture with a given width / height.

    Args:
        picture: (h, w, 3) uint8.
        aspect: Width / height, positive.

    Returns:
        (h', w', 3) uint8, at least one pixel each way.
    """
    height, width = picture.shape[:2]
    new_width = max(1, min(width, round(height * aspect)))
    new_height = max(1, min(height, round(width / aspect)))
    left, top = (width - new_width) // 2, (height - new_height) // 2
    return picture[top : top + new_height, left : left + new_width]
