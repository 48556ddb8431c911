"""A text segmenter out of a segmenter and an encoder: propose, then rank."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gvr_core.models.base import Encoder, Frame, Mask, Segmenter


class RankedProposals:
    """Every automatic mask of a frame is a proposal; the one most like the text is the answer.

    It stands in for Grounding DINO with SAM where their weights cannot be had, and it always
    answers when there is anything to see: telling that an object is absent is left to whoever
    reads the score.

    Args:
        segmenter: Makes the proposals.
        encoder: Compares them with the text.
        min_score: Proposals whose own score is below are left out, unless all are: a segmenter
            is less sure of fragments, and among many fragments one looks like anything.
    """

    def __init__(self, segmenter: Segmenter, encoder: Encoder, min_score: float = 0.5) -> None:
        self._min_score = min_score
        self._segmenter = segmenter
        self._encoder = encoder

    @property
    def name(self) -> str:
        """Name, version, and the two models it is made of."""
        parts = f"{self._segmenter.name},{self._encoder.name}"
        return f"onboard-ranked/1(min_score={self._min_score},{parts})"

    def segment(self, frame: Frame, text: str) -> Mask | None:
        """The proposal most like the text.

        Args:
            frame: The picture.
            text: What to look for.

        Returns:
            The mask, its score the cosine similarity in [-1, 1]; of equal ones the first. None
            where the frame shows nothing.
        """
        proposals = self._segmenter.automatic(frame)
        if not proposals:
            return None
        proposals = [m for m in proposals if m.score >= self._min_score] or proposals
        patches = self._encoder.encode_patches(frame, proposals)
        similarity = patches @ self._encoder.encode_texts([text])[0]
        best = int(np.argmax(similarity))
        return replace(proposals[best], score=float(similarity[best]))
