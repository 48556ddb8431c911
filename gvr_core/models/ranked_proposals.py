"""A text segmenter out of a segmenter and an encoder: propose, then rank."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from gvr_core.models.base import Encoder, Frame, Mask, Segmenter
from gvr_core.models.frame_memory import FrameMemory, SeenFrame


class RankedSettings(BaseModel):
    """How proposals are ranked."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    tie_margin: float = Field(default=0.02, ge=0)
    """Similarities this close to the best one count as equal; then the whole goes before its
    parts, and the large before the small."""


class RankedProposals:
    """Every automatic mask of a frame is a proposal; the one most like the text is the answer.

    It stands in for Grounding DINO with SAM where their weights cannot be had. It always answers
    when there is anything to see: telling that something is absent is left to whoever reads the
    score. Frames that it saw lately are not looked at twice: queries share them.

    Args:
        segmenter: Makes the proposals.
        encoder: Compares them with the text.
        settings: How they are ranked.
    """

    def __init__(
        self, segmenter: Segmenter, encoder: Encoder, settings: RankedSettings | None = None
    ) -> None:
        self._segmenter = segmenter
        self._encoder = encoder
        self._settings = settings or RankedSettings()
        self._memory = FrameMemory()

    @property
    def name(self) -> str:
        """Name, version, settings, and the two models it is made of."""
        parts = f"{self._segmenter.name},{self._encoder.name}"
        return f"onboard-ranked/1(tie_margin={self._settings.tie_margin},{parts})"

    def segment(self, frame: Frame, text: str) -> Mask | None:
        """The proposal most like the text.

        Args:
            frame: The picture.
            text: What to look for.

        Returns:
            The mask, its score the cosine similarity in [-1, 1]; None where the frame shows
            nothing. Of proposals that are equally like the text, the coarsest, then the largest,
            then the first.
        """
        seen = self._memory.recall(frame, lambda: self._look(frame))
        if not len(seen.features):
            return None
        similarity = seen.features @ self._encoder.encode_texts([text])[0]
        equal = np.flatnonzero(similarity >= similarity.max() - self._settings.tie_margin)
        areas = seen.areas
        best = max(equal, key=lambda i: (seen.levels[i], areas[i], -i))
        return replace(seen.mask(int(best)), score=float(similarity[best]))

    def _look(self, frame: Frame) -> SeenFrame:
        proposals = self._segmenter.automatic(frame)
        features = np.empty((0, self._encoder.dim), np.float32)
        if proposals:
            features = self._encoder.encode_patches(frame, proposals)
        height, width = frame.depth.shape
        return SeenFrame.of(proposals, features, (height, width))
