"""Writing a scene in the layout of LERF-OVS (see `datasets.lerf_ovs`)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datasets.base import SceneData
from datasets.exporting import Shot, new_folder, prompts, write_capture, write_photograph
from datasets.lerf_labels import Corners
from datasets.lerf_ovs import LABELS
from datasets.outline_polygons import outline_polygons, polygon_area
from datasets.provenance import mark_export
from gvr_core.atomic import atomic_write
from gvr_core.errors import DatasetError
from gvr_core.metrics import truth_box
from gvr_core.protocols.base import Box
from gvr_core.rendering.base import Renderer
from gvr_core.scene import View


def frame_stems(data: SceneData) -> dict[str, str]:
    """View -> the frame that it becomes: ``frame_00001`` and so on, all views in name order.

    Numbered without a gap, so that a frame's number is also its place among the sorted images,
    as LangSplat's evaluator takes it.
    """
    names = {view.name for view in (*data.scene.views, *data.truth.test_views)}
    return {name: f"frame_{i:05d}" for i, name in enumerate(sorted(names), start=1)}


def export_lerf_ovs(data: SceneData, root: Path, renderer: Renderer) -> Path:
    """Write one scene as a tree of LERF-OVS, with labels that draw its own masks exactly.

    Knowledge views and test views become registered images; the test views that show an object
    are the labelled ones. An object of several parts, or with holes, becomes several labelled
    objects of one category, whose polygons drawn together are the mask bit for bit. Their boxes
    are those that the scene states, else each has the box of the whole mask, so that scores are
    those of the mask. What the layout has no room for is left behind: labels in 3D, the up
    direction, further wordings, queries for what is absent, and which views were held out.

    Args:
        data: The scene.
        root: Folder of the data set; gets a folder of the scene's name, and one in ``label/``.
        renderer: Draws the views that have no picture.

    Returns:
        The scene's folder. It and its labels appear whole, the labels last: a scene without
        labels, which is all that an export killed between the two can leave, is refused on
        reading.

    Raises:
        DatasetError: if a folder is there already, no test view shows an object, the scene is
            called as the labels' folder is, or an object has no text of its own.
        OSError: if a file cannot be written.
    """
    name = data.scene.name
    folder, label_folder = root / name, root / LABELS / name
    if name == LABELS:
        raise DatasetError(
            f"a scene named {name!r}", path=folder, accepted="a name that is not the labels'"
        )
    stems, texts = frame_stems(data), prompts(data)
    tests = {view.name: view for view in data.truth.test_views}
    views = tests | {view.name: view for view in data.scene.views}
    shots = [Shot(stem, views[view]) for view, stem in stems.items()]
    labelled = {
        view: objects
        for view in stems
        if view in tests and (objects := _objects(data, tests[view], texts))
    }
    if not labelled:
        raise DatasetError("no test view shows an object", path=folder, accepted="one mask or more")
    with new_folder(label_folder) as labels, new_folder(folder) as scene:
        write_capture(scene, data.scene.gaussians, shots, renderer)
        mark_export(scene, data)
        for view, objects in labelled.items():
            camera = tests[view].camera
            picture = labels / f"{stems[view]}.jpg"
            write_photograph(picture, data.scene.gaussians, tests[view], renderer)
            content = _label_json(picture.name, (camera.width, camera.height), objects)
            with atomic_write(picture.with_suffix(".json")) as stream:
                stream.write(content)
    return folder


def _objects(data: SceneData, view: View, texts: dict[str, str]) -> list[tuple[str, Corners, Box]]:
    """The labelled objects of a test view; those that it does not show are left out."""
    found = []
    for target, text in texts.items():
        mask = data.truth.mask(view, target)
        if mask.any():
            boxes = data.truth.boxes.get((view.name, target), ()) or (truth_box(mask),)
            found += [(text, *pair) for pair in _with_boxes(outline_polygons(mask), boxes)]
    return found


def _with_boxes(polygons: Sequence[Corners], boxes: Sequence[Box]) -> list[tuple[Corners, Box]]:
    """Each polygon with a box that holds it, and each box that is left with the first polygon."""
    pairs = []
    for polygon in polygons:
        low, high = np.floor(polygon.min(axis=0)), np.floor(polygon.max(axis=0))
        holding = (b for b in boxes if (low >= b[:2]).all() and (high <= b[2:]).all())
        pairs.append((polygon, next(holding, boxes[0])))
    used = {box for _, box in pairs}
    return pairs + [(polygons[0], box) for box in boxes if box not in used]


def _label_json(
    name: str, size: tuple[int, int], objects: Sequence[tuple[str, Corners, Box]]
) -> bytes:
    """The content of a label file in UTF-8, with the keys that the published files have."""
    listed = [
        {
            "category": category,
            "group": number,
            "segmentation": polygon.tolist(),
            "area": polygon_area(polygon),
            "layer": float(number),
            "bbox": list(box),
            "iscrowd": 0,
            "note": "",
        }
        for number, (category, polygon, box) in enumerate(objects, start=1)
    ]
    info = {"name": name, "width": size[0], "height": size[1], "depth": 3, "note": ""}
    return json.dumps({"info": info, "objects": listed}, indent=1).encode()
