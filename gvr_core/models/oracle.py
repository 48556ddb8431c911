"""Models that know the truth: true masks, true names. An upper bound, never a result.

With them in the place of the networks, all that is left to judge of a method is its geometry.
They need a scene whose Gaussians are labelled, and say in their names that they are oracles, so
that no figure of theirs can pass for a measurement of anything that has to see or to read.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gvr_core.gaussians import Gaussians
from gvr_core.models.base import BoolArray, FloatArray, Frame, Mask, Models
from gvr_core.rendering.base import Renderer, get_renderer

MIN_AREA = 12
"""Pieces smaller than this, in pixels, are no patches."""
JOIN_SHARE = 0.012
"""Pieces of one object that are nearer than twice this share of the picture's longer side make
one patch: leaves belong to their plant, a twin on the other side of the table does not."""
BACKGROUND_AXIS, ABSENT_AXIS = -2, -1
"""Axes of the oracle's space for what is no object, and for texts that mean nothing here."""


@dataclass(frozen=True, eq=False)
class OracleWorld:
    """The truth of a scene: which Gaussian belongs to which object, and what texts mean."""

    gaussians: Gaussians
    """The scene G."""
    labels: NDArray[np.int16]
    """(N,) index into ``objects``, -1 for the rest."""
    objects: tuple[str, ...]
    """Names of the objects."""
    meanings: Mapping[str, str]
    """Text -> object name; a text that is missing names nothing in the scene."""
    digest: str = ""
    """Digest of the scene, its truth and its queries; part of the models' names, and so of cache
    keys."""
    renderer: str = "numba"
    """Name of the renderer that draws the truth."""

    @property
    def name(self) -> str:
        """What the models made of this world are called."""
        return f"oracle/1({self.digest[:16]},{self.renderer})" if self.digest else "oracle/1"

    def shares(self, frame: Frame) -> FloatArray:
        """(objects, H, W) share of each pixel's light that comes from each object."""
        drawn, labels = self.gaussians, self.labels
        if frame.shown is not None:
            drawn, labels = drawn.subset(frame.shown), labels[frame.shown]
        renderer: Renderer = get_renderer(self.renderer)
        channels = []
        for first in range(0, len(self.objects), 3):
            codes = (labels[:, None] == np.arange(first, first + 3)).astype(np.float32)
            picture = renderer.render(drawn.recoloured(codes), frame.camera).rgb
            channels += [picture[..., j] for j in range(3)]
        return np.stack(channels[: len(self.objects)])

    def meaning(self, text: str) -> int | None:
        """Index of the object that a text means, or None."""
        name = self.meanings.get(text)
        return None if name is None else self.objects.index(name)


@dataclass(frozen=True)
class OracleSegmenter:
    """Patches: the pieces in which each object is seen, and all that is no object."""

    world: OracleWorld

    @property
    def name(self) -> str:
        """Name and digest of the world."""
        return self.world.name

    def automatic(self, frame: Frame) -> list[Mask]:
        """The pieces of every object, in the objects' order, then the rest of the picture."""
        truth = self.world.shares(frame) > 0.5
        masks = [Mask(piece) for pixels in truth for piece in _pieces(pixels)]
        rest = Mask(np.asarray(~truth.any(axis=0)))
        return [*masks, rest] if rest.area >= MIN_AREA else masks

    def at_point(self, frame: Frame, point: tuple[float, float]) -> Mask:
        """The piece that holds the point; else all that is no object."""
        truth = self.world.shares(frame) > 0.5
        row, column = int(np.floor(point[1])), int(np.floor(point[0]))
        if not (0 <= row < truth.shape[1] and 0 <= column < truth.shape[2]):
            return Mask(np.zeros(truth.shape[1:], np.bool_), 0.0)
        for pixels in truth:
            if pixels[row, column]:
                return Mask(next(p for p in _pieces(pixels, 1) if p[row, column]))
        return Mask(np.asarray(~truth.any(axis=0)))

    def in_box(self, frame: Frame, box: tuple[float, float, float, float]) -> Mask:
        """The piece whose own box overlaps most with the box; empty where none does."""
        pieces = [mask for mask in self.automatic(frame) if _box_iou(mask.box, box) > 0]
        if not pieces:
            return Mask(np.zeros(frame.depth.shape, np.bool_), 0.0)
        return max(pieces, key=lambda mask: _box_iou(mask.box, box))


@dataclass(frozen=True)
class OracleEncoder:
    """One axis of the space for each object, one for all else, one for what is not there."""

    world: OracleWorld

    @property
    def name(self) -> str:
        """Name and digest of the world."""
        return self.world.name

    @property
    def dim(self) -> int:
        """c: number of objects and two."""
        return len(self.world.objects) + 2

    def encode_patches(self, frame: Frame, masks: Sequence[Mask]) -> FloatArray:
        """(m, c) the axis of the object that covers more than half of each patch."""
        truth = self.world.shares(frame) > 0.5
        features = np.zeros((len(masks), self.dim), np.float32)
        for row, mask in enumerate(masks):
            cover = [float(pixels[mask.pixels].mean()) if mask.area else 0.0 for pixels in truth]
            best = int(np.argmax(cover))
            features[row, best if cover[best] > 0.5 else BACKGROUND_AXIS] = 1
        return features

    def encode_texts(self, texts: Sequence[str]) -> FloatArray:
        """(t, c) the axis of the object that each text means; the last one where it means none."""
        features = np.zeros((len(texts), self.dim), np.float32)
        for row, text in enumerate(texts):
            meant = self.world.meaning(text)
            features[row, ABSENT_AXIS if meant is None else meant] = 1
        return features


@dataclass(frozen=True)
class OracleTextSegmenter:
    """All pixels of the object that the text means."""

    world: OracleWorld

    @property
    def name(self) -> str:
        """Name and digest of the world."""
        return self.world.name

    def segment(self, frame: Frame, text: str) -> Mask | None:
        """The true mask; None where the text means nothing, or the object is not seen."""
        meant = self.world.meaning(text)
        if meant is None:
            return None
        mask = Mask(self.world.shares(frame)[meant] > 0.5)
        return mask if mask.area else None


def oracle_models(world: OracleWorld) -> Models:
    """The three oracles over one world."""
    return Models(OracleSegmenter(world), OracleEncoder(world), OracleTextSegmenter(world))


def _pieces(pixels: BoolArray, least: int = MIN_AREA) -> list[BoolArray]:
    """The parts of a mask that are apart from each other, in scan order."""
    reach = max(1, round(JOIN_SHARE * max(pixels.shape)))
    near = ndimage.distance_transform_edt(~pixels) <= reach if pixels.any() else pixels
    parts, count = ndimage.label(near)
    found = [(parts == part) & pixels for part in range(1, count + 1)]
    return [piece for piece in found if np.count_nonzero(piece) >= least]


def _box_iou(a: Sequence[float], b: Sequence[float]) -> float:
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    if width <= 0 or height <= 0:
        return 0.0
    both = width * height
    return both / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - both)
