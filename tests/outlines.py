"""Things on real photographs, outlined by hand: what a segmentation model is judged by.

`tests/data/outlines/outlines.json` holds the polygons and says how they are to be read; the
photographs come with scikit-image.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import skimage.data
from numpy.typing import NDArray
from skimage.draw import polygon2mask

OUTLINES = Path(__file__).resolve().parent / "data" / "outlines" / "outlines.json"


@dataclass(frozen=True)
class Outline:
    """One thing on one photograph; [x, y] pixels, a pixel's centre at its index + 0.5."""

    thing: str
    picture: str
    """A photograph of `skimage.data`, by its name."""
    width: int
    height: int
    sha256: str
    """Digest of the photograph's RGB values, row by row."""
    point: tuple[float, float]
    """Where a person would click to mean the thing."""
    polygons: tuple[NDArray[np.float64], ...]
    """(V, 2) vertices each; the thing is their union."""
    vague: str
    """Where the border cannot be told from the photograph."""

    @property
    def mask(self) -> NDArray[np.bool_]:
        """The pixels whose centres lie inside: (height, width) bool."""
        inside = np.zeros((self.height, self.width), dtype=bool)
        for polygon in self.polygons:
            # polygon2mask takes (row, column) and has a pixel's centre at its index
            inside |= polygon2mask(inside.shape, polygon[:, ::-1] - 0.5)
        return inside


def read_outlines(path: Path = OUTLINES) -> tuple[Outline, ...]:
    """Every outline of the file, in its order."""
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return tuple(
        Outline(
            thing=entry["thing"],
            picture=entry["picture"],
            width=picture["width"],
            height=picture["height"],
            sha256=picture["sha256"],
            point=(entry["point"][0], entry["point"][1]),
            polygons=tuple(np.asarray(polygon, dtype=np.float64) for polygon in entry["polygons"]),
            vague=entry["vague"],
        )
        for entry in document["outlines"]
        for picture in [document["pictures"][entry["picture"]]]
    )


def photograph(outline: Outline) -> NDArray[np.uint8]:
    """The photograph that an outline was drawn on: (height, width, 3) uint8 RGB.

    Raises:
        ValueError: scikit-image holds another picture by that name.
    """
    pixels: NDArray[np.uint8] = np.ascontiguousarray(getattr(skimage.data, outline.picture)())
    digest = hashlib.sha256(pixels.tobytes()).hexdigest()
    if pixels.shape != (outline.height, outline.width, 3) or digest != outline.sha256:
        raise ValueError(
            f"skimage.data.{outline.picture} is {pixels.shape} {digest}: not the photograph "
            f"that {outline.thing!r} was drawn on, {outline.sha256}"
        )
    return pixels
