"""The label files of LERF-OVS: polygons and boxes of named things in one frame.

::

    {"info": {"name": "frame_00043.jpg", "width": 988, "height": 730, ...},
     "objects": [{"category": "coffee mug", "segmentation": [[x, y], ...],
                  "bbox": [x1, y1, x2, y2], ...}, ...]}

Read as LangSplat's evaluator reads them (minghanqin/LangSplat, eval/utils.py): a category that
is there several times in a frame is the union of its polygons, with all its boxes. Keys that the
evaluator does not look at are not looked at here either.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from datasets.images import MAX_PIXELS
from datasets.mask_folders import Notes, check_text
from datasets.native_records import validation_error
from datasets.outline_polygons import polygon_area
from datasets.polygons import PolygonMask
from gvr_core.errors import DatasetError
from gvr_core.protocols.base import Box
from gvr_core.untrusted import parse_json, read_regular

MAX_COORDINATE = 1_000_000
"""Pixels. Corners further out are damage, and beyond what can be drawn."""

LOOSE_PIXELS = 1.0
"""Labelling tools round boxes and corners apart: this much is no disagreement."""

Corners = NDArray[np.float64]
Side = Annotated[int, Field(strict=True, ge=1)]


class LabelInfo(BaseModel):
    """``info``: the picture that was labelled."""

    model_config = ConfigDict(frozen=True)

    name: str = Field(min_length=1)
    """File name of the picture."""
    width: Side
    """Pixels."""
    height: Side
    """Pixels."""


class LabelObject(BaseModel):
    """One entry of ``objects``."""

    model_config = ConfigDict(frozen=True)

    category: str
    """The prompt, in the case in which it is written."""
    segmentation: list[Any]
    """Corners [[x, y], ...] of one polygon, pixels; see :func:`read_polygons`."""
    bbox: list[Any] | None = None
    """[x1, y1, x2, y2], pixels, ends inclusive."""


class LabelFile(BaseModel):
    """A label file; unknown keys are passed over."""

    model_config = ConfigDict(frozen=True)

    info: LabelInfo
    objects: tuple[LabelObject, ...]


@dataclass(frozen=True, eq=False)
class FrameLabels:
    """What is labelled in one frame."""

    path: Path
    """The label file."""
    size: tuple[int, int]
    """Width and height of the labelled picture, pixels."""
    masks: Mapping[str, PolygonMask]
    """Category as written -> its mask, in the order in which the file names them."""
    boxes: Mapping[str, tuple[Box, ...]]
    """Category as written -> its boxes, one for each object."""


def read_frame_labels(path: Path, notes: Notes) -> FrameLabels:
    """Read one label file.

    Args:
        path: ``label/<scene>/frame_XXXXX.json``.
        notes: Gets what is put right: a byte order mark, Windows line ends, objects that are
            there twice or have no box, polygons in COCO's form, enclosing nothing or reaching
            beyond the picture, and boxes that are reversed or do not hold their polygon.

    Raises:
        DatasetError: for a file that is no JSON, a missing size, a name that is not the file's,
            a blank category, a polygon of fewer than three corners or wholly outside of the
            picture, or a number that is none. It names the object's place in the file.
    """
    try:
        labels = LabelFile.model_validate(_read_json(path, notes))
    except ValidationError as error:
        raise validation_error(error, path) from error
    _check_info(labels.info, path)
    if not labels.objects:
        notes.add("labelled frames without an object", path.stem)
    size = (labels.info.width, labels.info.height)
    polygons: dict[str, list[Corners]] = {}
    boxes: dict[str, list[Box]] = {}
    known: set[tuple[str, bytes, Box]] = set()
    for index, item in enumerate(labels.objects):
        place = f"objects[{index}]"
        where = f"{path.stem}, {place}"
        category = check_text(item.category, path, f"{place}.category")
        parts, flat = read_polygons(item.segmentation, path, f"{place}.segmentation")
        if flat:
            notes.add("polygons as flat lists in COCO's form, taken for corners", where)
        _check_visible(parts, size, path, f"{place}.segmentation")
        corners = np.concatenate(parts)
        if not any(map(polygon_area, parts)):
            notes.add("polygons that enclose nothing, drawn as lines", where)
        if (corners < 0).any() or (corners > size).any():
            notes.add("polygons that reach beyond the picture, clipped", where)
        if item.bbox is None:
            notes.add("objects without a box, their polygon's taken", where)
            box = _around(corners)
        else:
            box = _read_box(item.bbox, path, f"{place}.bbox")
            if list(box) != item.bbox:
                notes.add("boxes whose corners are exchanged, put in order", where)
            low, high = corners.min(axis=0), corners.max(axis=0)
            if (low < np.array(box[:2]) - LOOSE_PIXELS).any() or (
                high > np.array(box[2:]) + LOOSE_PIXELS
            ).any():
                notes.add("boxes that do not hold their polygon, kept as stated", where)
        key = (category, b"|".join(part.tobytes() for part in parts), box)
        if key in known:
            notes.add("objects that are there twice, counted once", where)
            continue
        known.add(key)
        polygons.setdefault(category, []).extend(parts)
        boxes.setdefault(category, []).append(box)
    return FrameLabels(
        path,
        size,
        {name: PolygonMask(tuple(parts), size) for name, parts in polygons.items()},
        {name: tuple(stated) for name, stated in boxes.items()},
    )


def read_polygons(value: list[Any], path: Path, place: str) -> tuple[list[Corners], bool]:
    """The polygons of one ``segmentation``.

    Args:
        value: One polygon [[x, y], ...]; or several as flat lists [[x1, y1, x2, y2, ...], ...],
            which is COCO's form and what some tools save labels in. A list of pairs is always
            one polygon: a flat one has six numbers at least.
        path: The file, for the message.
        place: Where in the file, for the message.

    Returns:
        Polygons (k, 2), k >= 3, and whether they were flat.

    Raises:
        DatasetError: for anything else.
    """
    lists = [part for part in value if isinstance(part, list)]
    if len(lists) < len(value) or not lists:
        raise DatasetError(
            "no polygon" if not value else "not a list of corners",
            path=path,
            place=place,
            accepted="[[x, y], [x, y], [x, y], ...]",
        )
    flat = all(len(part) >= 6 and len(part) % 2 == 0 for part in lists)
    polygons = [[p[i : i + 2] for i in range(0, len(p), 2)] for p in lists] if flat else [lists]
    for number, polygon in enumerate(polygons):
        if len(polygon) < 3:
            raise DatasetError(
                f"a polygon with {len(polygon)} corners",
                path=path,
                place=place,
                accepted="three corners or more",
            )
        for index, corner in enumerate(polygon):
            if len(corner) != 2 or not all(map(_is_number, corner)):
                raise DatasetError(
                    f"the corner {str(corner)[:60]}",
                    path=path,
                    place=f"{place}[{number}], corner {index}" if flat else f"{place}[{index}]",
                    accepted=f"[x, y]: two numbers up to {MAX_COORDINATE}",
                )
    return [np.array(polygon, np.float64) for polygon in polygons], flat


def _around(corners: Corners) -> Box:
    (x0, y0), (x1, y1) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    return x0, y0, x1, y1


def _is_number(value: Any) -> bool:
    """Whether a value is a number that a corner can have; NaN is not, and true is none."""
    return type(value) in (int, float) and abs(value) <= MAX_COORDINATE


def _read_box(value: list[Any], path: Path, place: str) -> Box:
    """A box with its corners in order, as the published evaluator puts them."""
    if len(value) != 4 or not all(map(_is_number, value)):
        raise DatasetError(
            f"the box {str(value)[:80]}",
            path=path,
            place=place,
            accepted=f"[x1, y1, x2, y2]: numbers up to {MAX_COORDINATE}",
        )
    x0, y0, x1, y1 = map(float, value)
    return min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1)


def _check_info(info: LabelInfo, path: Path) -> None:
    """The labels are of the frame that the file is named after, and of a possible size."""
    if Path(info.name).stem != path.stem:
        raise DatasetError(
            f"the labels are of {info.name[:100]!r}",
            path=path,
            place="info.name",
            accepted=f"{path.stem}.jpg, as the file is named",
        )
    if info.width * info.height > MAX_PIXELS:
        raise DatasetError(
            f"a picture of {info.width} x {info.height} pixels",
            path=path,
            place="info",
            accepted=f"up to {MAX_PIXELS} pixels",
        )


def _check_visible(
    polygons: Sequence[Corners], size: tuple[int, int], path: Path, place: str
) -> None:
    if not PolygonMask(tuple(polygons), size).is_visible():
        raise DatasetError(
            "the polygon lies outside of the picture",
            path=path,
            place=place,
            accepted=f"corners within {size[0]} x {size[1]} pixels",
        )


def _read_json(path: Path, notes: Notes) -> Any:
    """The content of a label file."""
    try:
        raw = read_regular(path)
        content = parse_json(raw.decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        raise DatasetError(
            f"not JSON: {error.msg}", path=path, place=f"line {error.lineno}"
        ) from error
    except (OSError, ValueError) as error:
        raise DatasetError(
            f"cannot be read as JSON: {error}"[:200], path=path, accepted="JSON in UTF-8"
        ) from error
    if raw.startswith(b"\xef\xbb\xbf"):
        notes.add("label files that begin with a byte order mark, passed over", path.stem)
    if b"\r\n" in raw:
        notes.add("label files with Windows line ends, read as others", path.stem)
    return content
