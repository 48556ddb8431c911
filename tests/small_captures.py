"""A small capture on disk: splat, cameras and pictures where inria's tools put them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from small_scene import two_boxes

from datasets.colmap import write_colmap_text
from datasets.images import write_png
from gvr_core.cameras import Camera
from gvr_core.gaussians import Gaussians
from gvr_core.splat_io import write_ply

ITERATION = "point_cloud/iteration_{}/point_cloud.ply"
SCENE = "ramen"
Named = list[tuple[str, Camera]]


@cache
def some_gaussians() -> Gaussians:
    scene, _ = two_boxes(4)
    return scene.gaussians.subset(np.arange(len(scene.gaussians)) % 50 == 0)


def other_gaussians() -> Gaussians:
    """As of a splat that was trained again."""
    gaussians = some_gaussians()
    return gaussians.subset(np.arange(len(gaussians)) > 0)


@cache
def _views() -> tuple[tuple[str, Camera], ...]:
    scene, _ = two_boxes(4)
    return tuple((f"{view.name}.png", view.camera) for view in scene.views)


def some_views() -> Named:
    """Four images of the Gaussians, in name order."""
    return list(_views())


def stems(views: Named) -> Named:
    """Images as inria names them."""
    return [(Path(name).stem, camera) for name, camera in views]


def write_pictures(place: Path, views: Named, factor: float = 1) -> None:
    """Black pictures, smaller than their cameras by a factor."""
    for name, camera in views:
        shape = (round(camera.height / factor), round(camera.width / factor), 3)
        write_png(place / name, np.zeros(shape, np.uint8))


def write_capture(place: Path) -> Path:
    """COLMAP's cameras as text, pictures of their sizes, and the splat."""
    write_colmap_text(place / "sparse" / "0", some_views())
    write_pictures(place / "images", some_views())
    write_ply(place / ITERATION.format(30000), some_gaussians())
    return place
