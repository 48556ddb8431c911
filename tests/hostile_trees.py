"""The smallest scene that every layout can hold, made without a renderer: 12 x 9 pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datasets.export_lerf_mask import export_lerf_mask
from datasets.export_lerf_ovs import export_lerf_ovs
from datasets.export_ovs3d import export_ovs3d
from datasets.native import Picture, read_scene, write_scene
from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.gaussians import Gaussians
from gvr_core.scene import Query

SIZE = (12, 9)
OBJECTS = ("red box", "blue box")
QUERIES = (
    Query(id="red-1", text="a red box", target="red box"),
    Query(id="blue-1", text="a blue box", target="blue box"),
    Query(id="none-1", text="a zebra", absent=True),
)
SCENE = "tiny"
EXPORTS = {"lerf_ovs": export_lerf_ovs, "lerf_mask": export_lerf_mask, "ovs3d": export_ovs3d}


def some_gaussians(n: int = 6) -> Gaussians:
    """N Gaussians on a line through the middle, of degree 0."""
    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1))
    means = np.linspace(-0.3, 0.3, n)[:, None] * np.ones(3)
    return Gaussians(
        means.astype(np.float32),
        np.full((n, 3), 0.1, np.float32),
        quats,
        np.full(n, 0.9, np.float32),
        np.zeros((n, 1, 3), np.float32),
    )


def some_cameras(n: int = 3) -> dict[str, Camera]:
    """Cameras on a circle, by view name."""
    cameras = {}
    for i in range(n):
        eye = (4 * np.cos(i), 4 * np.sin(i), 1.0)
        cameras[f"v{i:02d}"] = Camera(
            intrinsics(60, *SIZE), look_at(eye, (0, 0, 0), (0, 0, 1)), *SIZE
        )
    return cameras


def native_scene(folder: Path) -> Path:
    """Write the scene in the native layout; its folder."""
    pixels = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    left, right = np.zeros((2, SIZE[1], SIZE[0]), bool)
    left[2:6, 1:5] = True
    right[3:8, 7:11] = True
    masks = dict(zip(OBJECTS, (left, right), strict=True))
    pictures = [
        Picture(name, camera, pixels, masks if name == "v01" else None)
        for name, camera in some_cameras().items()
    ]
    write_scene(
        folder,
        dataset="test",
        name=SCENE,
        gaussians=some_gaussians(),
        pictures=pictures,
        objects=OBJECTS,
        labels=np.array([0, 0, 1, 1, -1, -1], np.int16),
        queries=QUERIES,
        up=(0.0, 0.0, 1.0),
        provenance="made by a test",
    )
    return folder


def published_tree(layout: str, folder: Path) -> Path:
    """Write the scene in a published layout; the root of its tree."""
    data = read_scene(native_scene(folder / "native" / SCENE))
    # All views have pictures, so that nothing is drawn.
    EXPORTS[layout](data, folder / layout, None)  # type: ignore[arg-type]
    return folder / layout
