"""A small scene in the native layout, written where a test wants it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from small_scene import OBJECTS, two_boxes

from datasets.making import take_pictures
from datasets.native import write_scene
from gvr_core.rendering.base import get_renderer
from gvr_core.scene import Query

TESTS = ("v01", "v04")
QUERIES = (
    Query(id="red-1", text="a red box", target="red box"),
    Query(id="blue-1", text="a blue box", target="blue box"),
    Query(id="absent-1", text="a zebra", absent=True),
)


def parts(views: int = 5) -> dict[str, Any]:
    """What `write_scene` takes, for two boxes on a plane."""
    scene, labels = two_boxes(views)
    cameras = {view.name: view.camera for view in scene.views}
    gaussians = replace(scene.gaussians)
    return {
        "dataset": "test",
        "name": "two-boxes",
        "gaussians": gaussians,
        "pictures": take_pictures(
            get_renderer("numba"), gaussians, labels, OBJECTS, cameras, TESTS
        ),
        "objects": OBJECTS,
        "labels": labels,
        "queries": QUERIES,
        "up": (0.0, 0.0, 2.0),
        "provenance": "made by a test",
    }


def written(folder: Path, **changes: Any) -> Path:
    """The scene on disk; its folder."""
    write_scene(folder, **{**parts(), **changes})
    return folder
