"""A small tree in the layout of LERF-OVS, written where a test wants it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from native_scene import written

from datasets.base import SceneData
from datasets.export_lerf_ovs import export_lerf_ovs
from datasets.native import read_scene
from gvr_core.rendering.base import get_renderer

Change = Callable[[dict[str, Any]], object]

SCENE = "two-boxes"
FRAMES = ("frame_00002", "frame_00005")
"""What the test views v01 and v04 become."""


def exported(folder: Path) -> tuple[SceneData, Path]:
    """Two boxes on a plane in the native layout, and the root of their tree."""
    data = read_scene(written(folder / "native" / SCENE))
    export_lerf_ovs(data, folder / "tree", get_renderer("numba"))
    return data, folder / "tree"


def label_path(root: Path, frame: str = FRAMES[0]) -> Path:
    """A label file of the tree."""
    return root / "label" / SCENE / f"{frame}.json"


def edit(root: Path, change: Change, frame: str = FRAMES[0]) -> Path:
    """Change the content of a label file; its path."""
    path = label_path(root, frame)
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    return path


def first(key: str, value: Any) -> Change:
    """Another value for a key of the first object."""
    return lambda content: content["objects"][0].update({key: value})


def info(key: str, value: Any) -> Change:
    """Another value for a key of the labelled picture."""
    return lambda content: content["info"].update({key: value})
