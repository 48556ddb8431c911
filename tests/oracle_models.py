"""Test doubles: models that know the truth. They stand in tests only.

With true masks and true names, what is left to judge is the geometry of a method.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gvr_core.gaussians import Gaussians
from gvr_core.models.base import Frame, Mask, Models
from gvr_core.rendering import get_renderer

BACKGROUND = -1


@dataclass(frozen=True, eq=False)
class OracleWorld:
    """The truth of a scene: which Gaussian belongs to which object, and what texts mean."""

    gaussians: Gaussians
    labels: NDArray[np.int16]
    objects: tuple[str, ...]
    meanings: Mapping[str, str]
    """Text -> object name; a text that is missing names nothing in the scene."""

    def shares(self, frame: Frame) -> NDArray[np.float32]:
        """(objects, H, W): share of each pixel's light that comes from each object."""
        shown = np.ones(len(self.gaussians), np.bool_) if frame.shown is None else frame.shown
        drawn, labels = self.gaussians.subset(shown), self.labels[shown]
        renderer = get_renderer("numba")
        channels = []
        for first in range(0, len(self.objects), 3):
            codes = np.stack([labels == first + j for j in range(3)], axis=1).astype(np.float32)
            picture = renderer.render(drawn.recoloured(codes), frame.camera).rgb
            channels += [picture[..., j] for j in range(3)]
        return np.stack(channels[: len(self.objects)])

    def mask(self, frame: Frame, index: int) -> NDArray[np.bool_]:
        """(H, W) true mask of an object, or of all that is none (BACKGROUND)."""
        shares = self.shares(frame)
        return shares.max(axis=0) <= 0.5 if index == BACKGROUND else shares[index] > 0.5


@dataclass(frozen=True)
class OracleSegmenter:
    world: OracleWorld
    name: str = "test-oracle"

    def automatic(self, frame: Frame) -> list[Mask]:
        masks = [Mask(share > 0.5) for share in self.world.shares(frame)]
        masks.append(Mask(self.world.mask(frame, BACKGROUND)))
        return [mask for mask in masks if mask.area >= 20]

    def at_point(self, frame: Frame, point: tuple[float, float]) -> Mask:
        row, column = int(point[1]), int(point[0])
        for index in range(len(self.world.objects)):
            pixels = self.world.mask(frame, index)
            if pixels[row, column]:
                return Mask(pixels)
        return Mask(self.world.mask(frame, BACKGROUND))

    def in_box(self, frame: Frame, box: tuple[float, float, float, float]) -> Mask:
        raise NotImplementedError("the paper's method prompts with points only")


@dataclass(frozen=True)
class OracleEncoder:
    world: OracleWorld
    name: str = "test-oracle"

    @property
    def dim(self) -> int:
        return len(self.world.objects) + 2

    def encode_patches(self, frame: Frame, masks: Sequence[Mask]) -> NDArray[np.float32]:
        shares = self.world.shares(frame) > 0.5
        features = np.zeros((len(masks), self.dim), np.float32)
        for row, mask in enumerate(masks):
            cover = [np.mean(share[mask.pixels]) for share in shares]
            best = int(np.argmax(cover))
            features[row, best if cover[best] > 0.5 else len(self.world.objects)] = 1
        return features

    def encode_texts(self, texts: Sequence[str]) -> NDArray[np.float32]:
        features = np.zeros((len(texts), self.dim), np.float32)
        for row, text in enumerate(texts):
            name = self.world.meanings.get(text)
            features[row, -1 if name is None else self.world.objects.index(name)] = 1
        return features


@dataclass(frozen=True)
class OracleTextSegmenter:
    world: OracleWorld
    name: str = "test-oracle"

    def segment(self, frame: Frame, text: str) -> Mask | None:
        name = self.world.meanings.get(text)
        if name is None:
            return None
        mask = Mask(self.world.mask(frame, self.world.objects.index(name)))
        return mask if mask.area else None


def oracle_models(world: OracleWorld) -> Models:
    """The three oracles over one world."""
    return Models(OracleSegmenter(world), OracleEncoder(world), OracleTextSegmenter(world))
