"""What a model has found in the frames that it saw last: several queries look at one picture."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gvr_core.models.base import FloatArray, Frame, Mask
from gvr_core.models.recent import Recent

MOST_BYTES = 128 * 2**20
"""Frames are forgotten, the oldest first, where more than this would be kept."""


@dataclass(frozen=True, eq=False)
class SeenFrame:
    """The patches of a frame and their semantic vectors, packed eight pixels to a byte."""

    packed: NDArray[np.uint8]
    """(m, ceil(H W / 8)) masks."""
    shape: tuple[int, int]
    """Height and width, pixels."""
    scores: tuple[float, ...]
    levels: tuple[int, ...]
    features: FloatArray
    """(m, c) semantic vectors."""

    @classmethod
    def of(cls, masks: Sequence[Mask], features: FloatArray, shape: tuple[int, int]) -> SeenFrame:
        """Pack the patches of a frame.

        Args:
            masks: The m patches.
            features: (m, c) their vectors.
            shape: Height and width, pixels.
        """
        flat = np.array([mask.pixels for mask in masks], np.bool_)
        flat = flat.reshape(len(masks), shape[0] * shape[1])
        scores = tuple(mask.score for mask in masks)
        levels = tuple(mask.level for mask in masks)
        return cls(np.packbits(flat, axis=1), shape, scores, levels, features)

    def mask(self, j: int) -> Mask:
        """Patch j."""
        height, width = self.shape
        flat = np.unpackbits(self.packed[j], count=height * width).astype(np.bool_)
        return Mask(flat.reshape(height, width), self.scores[j], self.levels[j])

    @property
    def areas(self) -> NDArray[np.int64]:
        """(m,) pixels of each patch."""
        return np.asarray(np.bitwise_count(self.packed).sum(axis=1), np.int64)

    @property
    def n_bytes(self) -> int:
        """Memory that it takes."""
        return self.packed.nbytes + self.features.nbytes


class FrameMemory:
    """The last frames by content.

    Args:
        most_bytes: Limit of what is kept; the newest frame is always.
    """

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self._frames: Recent[SeenFrame] = Recent(most_bytes, lambda seen: seen.n_bytes)

    def recall(self, frame: Frame, look: Callable[[], SeenFrame]) -> SeenFrame:
        """What was found in a frame of the same content, or else what looking finds.

        Args:
            frame: The frame.
            look: Looks at it.
        """
        return self._frames.recall(content_key(frame), look)


def content_key(frame: Frame) -> bytes:
    """Digest of everything that a frame holds."""
    camera = frame.camera
    parts = (frame.rgb, frame.depth, frame.alpha, frame.shown, camera.K, camera.world_to_camera)
    digest = hashlib.blake2b(digest_size=16)
    for array in parts:
        if array is None:
            digest.update(b"none")
            continue
        digest.update(f"{array.shape}{array.dtype}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.digest()
