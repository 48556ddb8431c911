"""What models take and give: frames, masks, and three protocols."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gvr_core.cameras import Camera
from gvr_core.rendering.base import Rendering

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Frame:
    """A picture as models see it: colour, depth, and where it was taken from."""

    rgb: FloatArray
    """(H, W, 3) colour in [0, 1]."""
    depth: FloatArray
    """(H, W) z-depth in scene units, 0 where nothing is."""
    camera: Camera
    """The camera of the picture."""
    alpha: FloatArray | None = None
    """(H, W) accumulated opacity, where the picture is a render."""
    shown: BoolArray | None = None
    """(N,) flags of the Gaussians drawn; None for the whole scene or a photograph."""

    @classmethod
    def of_rendering(
        cls, rendering: Rendering, camera: Camera, shown: BoolArray | None = None
    ) -> Frame:
        """The frame of a render: colour clipped to [0, 1], median depth."""
        return cls(
            np.clip(rendering.rgb, 0, 1), rendering.median_depth, camera, rendering.alpha, shown
        )


@dataclass(frozen=True, eq=False)
class Mask:
    """A region of a picture."""

    pixels: BoolArray
    """(H, W) True inside."""
    score: float = 1.0
    """How sure the model is; comparable only within one model."""
    level: int = 0
    """Granularity, 0 the finest."""

    @property
    def area(self) -> int:
        """Number of pixels inside."""
        return int(np.count_nonzero(self.pixels))

    @property
    def box(self) -> tuple[int, int, int, int]:
        """Tight box (x0, y0, x1, y1) in pixels, x1 and y1 exclusive; zeros where empty."""
        columns = np.flatnonzero(self.pixels.any(axis=0))
        if columns.size == 0:
            return (0, 0, 0, 0)
        rows = np.flatnonzero(self.pixels.any(axis=1))
        return (int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1)


def views_at_once(model: Segmenter | Encoder) -> int:
    """How many frames a segmenter or encoder may be given at the same time, from threads.

    One, unless it has a property of this name: where one frame leaves processors idle, and the
    answer does not depend on what else is being looked at.
    """
    return max(1, int(getattr(model, "views_at_once", 1)))


class Segmenter(Protocol):
    """Cuts pictures into masks; SAM's role."""

    @property
    def name(self) -> str:
        """Name, version and settings; part of the cache key of everything below it."""
        ...

    def automatic(self, frame: Frame) -> list[Mask]:
        """All patches of a frame, in an order that is the same on every run."""
        ...

    def at_point(self, frame: Frame, point: tuple[float, float]) -> Mask:
        """The mask that a point (x, y), in pixels, lies in. May be empty, never missing."""
        ...

    def in_box(self, frame: Frame, box: tuple[float, float, float, float]) -> Mask:
        """The mask of what a box (x0, y0, x1, y1), in pixels, frames."""
        ...


class Encoder(Protocol):
    """Puts patches and texts into one space; CLIP's role."""

    @property
    def name(self) -> str:
        """Name, version and settings; part of the cache key of everything below it."""
        ...

    @property
    def dim(self) -> int:
        """c: length of a semantic vector."""
        ...

    def encode_patches(self, frame: Frame, masks: Sequence[Mask]) -> FloatArray:
        """Semantic vectors (m, c) of the patches of one frame, each of length 1."""
        ...

    def encode_texts(self, texts: Sequence[str]) -> FloatArray:
        """Semantic vectors (t, c) of texts, each of length 1."""
        ...


class TextSegmenter(Protocol):
    """Finds what a text names in one picture; Grounding DINO's and SAM's role together."""

    @property
    def name(self) -> str:
        """Name, version and settings; part of the cache key of everything below it."""
        ...

    def segment(self, frame: Frame, text: str) -> Mask | None:
        """The mask of what the text names, with a score; None where nothing is found."""
        ...


@dataclass(frozen=True)
class Models:
    """The three models that a method works with."""

    segmenter: Segmenter
    encoder: Encoder
    text_segmenter: TextSegmenter
