"""Text -> boxes -> masks: Grounding DINO's boxes as prompts of a segmenter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gvr_core.models.base import FloatArray, Frame, Mask, Segmenter
from gvr_core.models.bert_folder import BertFolder, bert_folder
from gvr_core.models.checkpoints import Checkpoint, checkpoint
from gvr_core.models.crops import to_uint8
from gvr_core.models.devices import DeviceChoice
from gvr_core.models.grounding_dino import GroundingDino
from gvr_core.models.grounding_dino_config import GroundingDinoSettings, Keep, check_variant
from gvr_core.weights.folder import located

KIND = "grounded_sam"
"""First part of the names ``grounded_sam:swin_b`` and ``grounded_sam:swin_t``, as suites and the
manifest of checkpoints say them."""

BERT = "bert-base-uncased"
"""The text encoder that the published checkpoints were trained with; its name in the manifest."""


class GroundedSegmenter:
    """Grounded SAM (Ren et al., 2024): a detector frames what a text names, a segmenter cuts it.

    Every text costs a whole pass of the detector, also on a picture that was seen before: the
    library computes image and text together. The segmenter may keep its picture's embedding.

    Args:
        detector: Finds the boxes.
        segmenter: Takes them as prompts.
        keep: ``"best"`` for the mask of the most probable box, ``"all"`` for the union of all.
    """

    def __init__(self, detector: GroundingDino, segmenter: Segmenter, keep: Keep = "best") -> None:
        self._detector = detector
        self._segmenter = segmenter
        self._keep = keep

    @property
    def name(self) -> str:
        """Name, version, settings, and the two models it is made of."""
        parts = f"{self._detector.name},keep={self._keep},{self._segmenter.name}"
        return f"grounded_sam/1({parts})"

    def segment(self, frame: Frame, text: str) -> Mask | None:
        """The mask of what the text names.

        Args:
            frame: The picture.
            text: What to look for.

        Returns:
            The mask, its score the probability in [0, 1] of the most probable box, the first of
            equals; None where no box is above the thresholds or the segmenter finds nothing in
            it.

        Raises:
            ModelError: for a text without words, weights that are missing or do not fit, or
                where memory runs out.
        """
        found = self._detector.find(to_uint8(frame.rgb), text)
        if not len(found.scores):
            return None
        best = int(found.scores.argmax())
        mask = self._in_box(frame, found.corners[best])
        if self._keep == "all":
            others = [box for i, box in enumerate(found.corners) if i != best]
            pixels = [self._in_box(frame, box).pixels for box in others]
            mask = replace(mask, pixels=np.logical_or.reduce([mask.pixels, *pixels]))
        return replace(mask, score=float(found.scores[best])) if mask.area else None

    def _in_box(self, frame: Frame, box: FloatArray) -> Mask:
        x0, y0, x1, y1 = map(float, box)
        return self._segmenter.in_box(frame, (x0, y0, x1, y1))


def grounded(
    variant: str,
    settings: GroundingDinoSettings,
    device: DeviceChoice,
    segmenter: Segmenter,
) -> GroundedSegmenter:
    """Grounding DINO of a variant in front of a segmenter; nothing is loaded yet.

    Args:
        variant: ``"swin_b"`` or ``"swin_t"``.
        settings: Files in place of those in the models folder, and thresholds.
        device: Where the detector computes.
        segmenter: Takes its boxes as prompts.

    Raises:
        ConfigError: for an unknown variant, keys that cannot be used, or CUDA where there is none.
        ModelError: for files that are missing or have another digest, naming the command that
            fetches them.
    """
    check_variant(variant)
    weights, bert = _weights(variant, settings), _bert(settings)
    detector = GroundingDino(variant, weights, bert, settings, device)
    return GroundedSegmenter(detector, segmenter, settings.keep)


def _weights(variant: str, settings: GroundingDinoSettings) -> Checkpoint:
    if settings.checkpoint is not None:
        return checkpoint(settings.checkpoint)
    file = located(f"{KIND}:{variant}")[0]
    return checkpoint(file.path, file.sha256)


def _bert(settings: GroundingDinoSettings) -> BertFolder:
    if settings.bert is not None:
        return bert_folder(settings.bert, f"gvr models fetch {BERT}")
    return bert_folder(located(BERT)[0].path.parent)
