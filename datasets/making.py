"""What the makers of scenes share: pictures and exact masks by rendering, and making once."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.native import Picture, read_recipe
from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.gaussians import Gaussians
from gvr_core.locks import file_lock
from gvr_core.rendering.base import Renderer

RENDERER = "numba"
"""Draws the pictures and the masks; another version of it makes the scenes anew."""

VISIBLE = 0.5
"""A pixel belongs to an object that makes up more than this part of its colour."""


def take_pictures(
    renderer: Renderer,
    gaussians: Gaussians,
    labels: NDArray[np.int16],
    objects: Sequence[str],
    cameras: Mapping[str, Camera],
    test_views: Sequence[str],
) -> list[Picture]:
    """Renders of a scene, with the exact masks of its objects in the test views.

    Args:
        renderer: Draws them.
        gaussians: The scene.
        labels: (N,) int16 index into ``objects``, -1 for the rest.
        objects: Names of the objects.
        cameras: View name -> camera.
        test_views: Names of the views that get masks.

    Returns:
        One picture a camera, in the order of the cameras.
    """
    pictures = []
    for name, camera in cameras.items():
        rgb = np.clip(renderer.render(gaussians, camera).rgb, 0, 1)
        masks = None
        if name in test_views:
            found = visible(renderer, gaussians, labels, len(objects), camera)
            masks = dict(zip(objects, found, strict=True))
        pictures.append(Picture(name, camera, np.rint(255 * rgb).astype(np.uint8), masks))
    return pictures


def visible(
    renderer: Renderer,
    gaussians: Gaussians,
    labels: NDArray[np.int16],
    objects: int,
    camera: Camera,
) -> NDArray[np.bool_]:
    """Where each object is seen, among and behind all the others.

    An object drawn white, and all the rest black, on black, has in each pixel the sum of its
    Gaussians' blending weights alpha_g T for a colour. The three channels serve three objects.

    Args:
        renderer: Draws them.
        gaussians: The scene, N Gaussians.
        labels: (N,) int16 index of each Gaussian's object, -1 for the rest.
        objects: Number of objects.
        camera: Where from.

    Returns:
        (objects, H, W) bool.
    """
    masks = np.zeros((objects, camera.height, camera.width), np.bool_)
    for first in range(0, objects, 3):
        last = min(first + 3, objects)
        channels = labels[:, None] == np.arange(first, first + 3)
        weights = renderer.render(gaussians.recoloured(channels.astype(np.float32)), camera).rgb
        masks[first:last] = np.moveaxis(weights, -1, 0)[: last - first] > VISIBLE
    return masks


def orbit_camera(
    target: Sequence[float],
    radius: float,
    yaw_degrees: float,
    pitch_degrees: float,
    size: tuple[int, int],
    fov_degrees: float,
) -> Camera:
    """A camera on a sphere around a point, z up.

    Args:
        target: (3,) point in the middle of the picture.
        radius: Distance from it.
        yaw_degrees: 0 is in front (-y), 90 to the right (+x).
        pitch_degrees: Angle above the horizontal plane.
        size: Width and height, pixels.
        fov_degrees: Horizontal field of view.
    """
    yaw, pitch = np.radians(yaw_degrees), np.radians(pitch_degrees)
    level = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    eye = np.asarray(target) + radius * (np.cos(pitch) * level + np.sin(pitch) * np.eye(3)[2])
    matrix = look_at(eye, target, (0, 0, 1))
    return Camera(intrinsics(fov_degrees, *size), matrix, *size)


def slug(name: str) -> str:
    """An object's name as the beginning of query ids."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") or "object"


def recipe_digest(*parts: Any) -> str:
    """sha256 of what a scene is made from: JSON values only, in order."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def made_once(folder: Path, recipe: str, make: Callable[[], None]) -> None:
    """Make a scene, unless the folder already holds the one of that recipe.

    Two processes that want the same scene make it once: the second waits for the first, and a
    killed one leaves no lock behind, since the system drops it.

    Args:
        folder: The scene's folder.
        recipe: Digest of everything that it is made from.
        make: Writes the scene, whole or not at all.
    """
    if read_recipe(folder) == recipe:
        return
    folder.parent.mkdir(parents=True, exist_ok=True)
    with file_lock(folder.parent / f".{folder.name}.lock"):
        if read_recipe(folder) != recipe:
            make()
