"""The pictures that a page holds: evidence where it was kept, and what there is where not."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, UnidentifiedImageError

from reports.evidence import picture_fields, read_evidence, thumbnail_size, to_webp
from reports.record import Result, SceneResult
from reports.result_check import ResultError
from reports.result_io import read_sums

FALLBACK_WIDTH = 480
"""Widest picture of an answer that has no evidence, pixels."""


@dataclass
class PagePictures:
    """What the page holds of evidence, and what it had to leave out."""

    blocks: list[dict[str, Any]] = field(default_factory=list)
    """One for each (scene, method) that has any."""
    of_line: dict[tuple[str, str, str], int] = field(default_factory=dict)
    n_bytes: int = 0
    left_out: list[str] = field(default_factory=list)


def page_pictures(folder: Path, result: Result, most_bytes: int) -> PagePictures:
    """Evidence, or for results without it the pictures of the answers, as far as there is room."""
    sums = read_sums(folder)
    found = PagePictures()
    for scene in result.scenes:
        key = (scene.dataset, scene.scene, scene.method)
        if scene.evidence is not None:
            block = read_evidence(folder, scene.evidence, sums).model_dump(mode="json")
        elif any(query.picture for query in scene.queries):
            block = {"plain": _plain_pictures(folder, scene)}
        else:
            continue
        size = len(json.dumps(block))
        if found.n_bytes + size > most_bytes:
            found.left_out.append(f"{scene.dataset}/{scene.scene} · {scene.method}")
            continue
        found.n_bytes += size
        found.of_line[key] = len(found.blocks)
        found.blocks.append(block)
    return found


def _plain_pictures(folder: Path, scene: SceneResult) -> dict[str, Any]:
    pictures = {}
    for query in scene.queries:
        if query.picture is not None:
            pictures[query.query] = small_picture(folder / query.picture)
    return pictures


def small_picture(path: Path) -> dict[str, Any]:
    """A picture of a result in small, as the fields of a :class:`reports.evidence.Picture`.

    Raises:
        ResultError: for a file that is missing or no picture.
    """
    try:
        with Image.open(io.BytesIO(path.read_bytes()), formats=["PNG"]) as opened:
            image = opened.convert("RGB")
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise ResultError(f"not a picture: {error}", path=path, accepted="a PNG") from error
    size = thumbnail_size(image.width, image.height, FALLBACK_WIDTH)
    return picture_fields(to_webp(np.asarray(image), FALLBACK_WIDTH), size)
