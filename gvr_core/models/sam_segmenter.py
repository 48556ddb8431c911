"""A SAM in the segmenter's role."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np

from gvr_core.models.base import Frame, Mask
from gvr_core.models.crops import to_uint8
from gvr_core.models.devices import Batches
from gvr_core.models.recent import Recent
from gvr_core.models.sam_automatic import automatic_masks
from gvr_core.models.sam_prompts import (
    MASK_THRESHOLD,
    PROMPT_BYTES,
    Embedding,
    PromptableSam,
    SamSettings,
    picture_logits,
)

MOST_BYTES = 128 * 2**20
"""Of embeddings, 4 MB each for the published models, that are kept for further prompts."""


class SamSegmenter:
    """Segment Anything (Kirillov et al., ICCV 2023): automatic masks, point and box prompts.

    Coordinates of prompts go to the model as they are; it adds half a pixel itself.

    Args:
        sam: The networks.
        settings: Grid and limits of the automatic masks.
    """

    def __init__(self, sam: PromptableSam, settings: SamSettings) -> None:
        self._sam = sam
        self._settings = settings
        self._prompts = Batches("prompts", PROMPT_BYTES, settings.points_at_once)
        self._embeddings: Recent[Embedding] = Recent(MOST_BYTES, lambda kept: kept.n_bytes)

    @property
    def name(self) -> str:
        """Name, version, weights and settings."""
        values = self._settings.model_dump(exclude={"points_at_once"})
        shown = ",".join(f"{key}={value}" for key, value in values.items())
        return f"{self._sam.name}({shown})"

    def automatic(self, frame: Frame) -> list[Mask]:
        """All patches by level, finest first; an empty list where nothing is shown.

        Points of the grid where a render shows nothing are not asked: what is found there has no
        depth to be projected back with. A frame without any depth is asked everywhere.
        """
        shown = frame.depth > 0
        return automatic_masks(
            self._sam,
            to_uint8(frame.rgb),
            self._settings,
            self._prompts,
            shown if shown.any() else None,
        )

    def at_point(self, frame: Frame, point: tuple[float, float]) -> Mask:
        """Of the three masks that a point may mean, the one predicted to be best.

        Args:
            frame: The picture.
            point: (x, y) in pixels.

        Returns:
            The mask, its score the predicted IoU, its level which of the three it is; empty,
            with score 0, where the point is outside of the picture.
        """
        height, width = frame.rgb.shape[:2]
        if not (0 <= point[0] < width and 0 <= point[1] < height):
            return Mask(np.zeros((height, width), np.bool_), 0.0)
        return max(self.masks_at(frame, point), key=lambda mask: mask.score)

    def masks_at(self, frame: Frame, point: tuple[float, float]) -> list[Mask]:
        """The three masks that a point (x, y), in pixels, may mean: finer ones first."""
        return self._masks(frame, [point], [True])

    def at_points(
        self, frame: Frame, points: Sequence[tuple[float, float]], inside: Sequence[bool]
    ) -> Mask:
        """The mask that several points describe together, where one would not be clear.

        Args:
            frame: The picture.
            points: (x, y) of each, in pixels.
            inside: Whether each lies in the thing, or in what does not belong to it.
        """
        return max(self._masks(frame, points, inside), key=lambda mask: mask.score)

    def _masks(
        self, frame: Frame, points: Sequence[tuple[float, float]], inside: Sequence[bool]
    ) -> list[Mask]:
        logits, scores = self._sam.decode_points(
            embedding := self._embedding(frame),
            np.array([points], np.float32),
            np.array([inside], np.int64),
        )
        full = picture_logits(logits, embedding, self._sam.side)[0]
        pixels = (full > MASK_THRESHOLD).cpu().numpy()
        return [Mask(mask, float(scores[0, i]), i) for i, mask in enumerate(pixels)]

    def in_box(self, frame: Frame, box: tuple[float, float, float, float]) -> Mask:
        """The mask of what a box (x0, y0, x1, y1), in pixels, frames; the score its IoU."""
        embedding = self._embedding(frame)
        logits, scores = self._sam.decode_box(embedding, np.array(box, np.float32))
        full = picture_logits(logits, embedding, self._sam.side)
        return Mask((full[0, 0] > MASK_THRESHOLD).cpu().numpy(), float(scores[0, 0]))

    def _embedding(self, frame: Frame) -> Embedding:
        """The picture's embedding, computed once for all prompts on it."""
        rgb8 = to_uint8(frame.rgb)
        key = hashlib.blake2b(f"{rgb8.shape}".encode() + rgb8.tobytes(), digest_size=16)
        return self._embeddings.recall(key.digest(), lambda: self._sam.embed(rgb8))
