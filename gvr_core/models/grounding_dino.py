"""Grounding DINO through its own library: a picture and a text in, boxes out."""

from __future__ import annotations

import hashlib
import json
import logging
import math
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gvr_core.errors import ModelError
from gvr_core.models.base import FloatArray
from gvr_core.models.bert_folder import BertFolder
from gvr_core.models.checkpoints import Checkpoint
from gvr_core.models.devices import Batches, DeviceChoice, pick_device
from gvr_core.models.grounding_dino_config import GroundingDinoSettings, configuration
from gvr_core.models.grounding_dino_network import SEPARATORS, shared_network

if TYPE_CHECKING:
    import torch

log = logging.getLogger(__name__)

DISTRIBUTION = "groundingdino-py"
"""The library's name where packages are installed from."""

MEAN, DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Of the colours that the backbones were trained with; the library's own preprocessing."""


@dataclass(frozen=True, eq=False)
class Boxes:
    """What was found in a picture, in the order of the detector's queries."""

    corners: FloatArray
    """(b, 4) float32 (x0, y0, x1, y1) in pixels, within the picture, none empty."""
    scores: FloatArray
    """(b,) float32 probability in [0, 1] of the most probable token."""


class GroundingDino:
    """Grounding DINO (Liu et al., "Marrying DINO with Grounded Pre-Training", ECCV 2024).

    The installed library computes its deformable attention in PyTorch alone, on every device: no
    compiled operator is needed for CUDA.

    Args:
        variant: Which of the published configurations the weights belong to.
        weights: The checkpoint; it holds BERT's weights too.
        bert: BERT's configuration and tokenizer.
        settings: Thresholds and picture size, and keys that differ from the variant's.
        device: Where to compute.

    Raises:
        ConfigError: for an unknown variant or a file of keys that cannot be used, or for CUDA
            where there is none.
        ModelError: if the library is not installed.

    Weights are loaded when they are first needed, once for all detectors of the same files. One
    picture is computed at a time.
    """

    def __init__(
        self,
        variant: str,
        weights: Checkpoint,
        bert: BertFolder,
        settings: GroundingDinoSettings | None = None,
        device: DeviceChoice = "auto",
    ) -> None:
        self._settings = settings or GroundingDinoSettings()
        self._variant = variant
        self._weights = weights
        self._bert = bert
        self._keys = configuration(variant, self._settings.config)
        self._library = _library_version()
        self._device = pick_device(device)
        self._content = json.dumps(self._keys, sort_keys=True, default=str)
        self._network = shared_network(self._content, bert, weights, variant, self._device)
        self._pictures = Batches("pictures", 1, 1)

    @property
    def name(self) -> str:
        """Variant, digests of all files, settings that change boxes, and the library's version."""
        s = self._settings
        keys = hashlib.sha256(self._content.encode()).hexdigest()[:12]
        keys = "" if s.config is None else f"config@{keys},"
        return (
            f"{self._variant}@{self._weights.tag},{keys}bert@{self._bert.tag},"
            f"box={s.box_threshold},text={s.text_threshold},"
            f"shorter={s.shorter_side},longest={s.longest_side},{DISTRIBUTION}={self._library}"
        )

    def find(self, rgb8: NDArray[np.uint8], text: str) -> Boxes:
        """Boxes of what a text names.

        Args:
            rgb8: (H, W, 3) uint8 picture.
            text: What to look for, in any case; a dot at its end is added where it lacks.

        Returns:
            The boxes above both thresholds.

        Raises:
            ModelError: for a text without words, weights that do not fit, a picture that gets too
                small, or where memory runs out.
        """
        import torch
        from torchvision.ops import box_convert

        if not text.strip(SEPARATORS + " \t\r\n"):
            raise ModelError(f"the text {text!r} names nothing", accepted="a text with words")
        with self._network.taken() as network:
            probabilities, boxes = self._pictures.run(
                lambda items: self._forward(network, *items[0]), [(rgb8, text)], self._device
            )[0]
        scores = probabilities.max(dim=1).values
        counts = (scores > self._settings.box_threshold) & (
            probabilities > self._settings.text_threshold
        ).any(dim=1)
        height, width = rgb8.shape[:2]
        limits = torch.tensor([width, height, width, height], dtype=boxes.dtype)
        corners = box_convert(boxes[counts] * limits, "cxcywh", "xyxy")
        corners = torch.minimum(corners.clamp(min=0), limits)
        filled = (corners[:, 2:] > corners[:, :2]).all(dim=1)
        return Boxes(corners[filled].numpy(), scores[counts][filled].numpy())

    def _forward(
        self, network: Any, rgb8: NDArray[np.uint8], text: str
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Probabilities (q, 256) of tokens; boxes (q, 4), centre and size as parts of its sides."""
        import torch
        from groundingdino.datasets import transforms
        from groundingdino.util.inference import preprocess_caption

        caption = preprocess_caption(text)
        n_tokens = len(network.tokenizer(caption)["input_ids"])
        if n_tokens > network.max_text_len:
            log.warning(
                "%d tokens, of which Grounding DINO reads the first %d: %.60r...",
                n_tokens,
                network.max_text_len,
                text,
            )
        picture, _ = transforms.ToTensor()(self._resized(rgb8), None)
        picture, _ = transforms.Normalize(MEAN, DEVIATION)(picture, None)
        with torch.no_grad():
            outputs = network(picture[None].to(self._device), captions=[caption])
        return outputs["pred_logits"][0].cpu().sigmoid(), outputs["pred_boxes"][0].cpu()

    def _resized(self, rgb8: NDArray[np.uint8]) -> Image.Image:
        """The picture as the detector wants it.

        There have to be as many places in its feature maps as there are queries, each of which
        starts at one of them.
        """
        from groundingdino.datasets import transforms

        height, width = rgb8.shape[:2]
        shorter, longest = self._settings.shorter_side, self._settings.longest_side
        strides = [4 * 2**i for i in self._keys["return_interm_indices"]]
        while len(strides) < self._keys["num_feature_levels"]:
            strides.append(2 * strides[-1])
        picture: Image.Image
        places = 0
        # At less than a pixel the library would ask for a picture without any.
        if min(height, width) * longest >= max(height, width):
            picture, _ = transforms.resize(Image.fromarray(rgb8), None, shorter, longest)
            places = sum(math.prod(math.ceil(n / s) for n in picture.size) for s in strides)
        if places < self._keys["num_queries"]:
            raise ModelError(
                f"a picture of {width} x {height} pixels gives {places} places to look at",
                accepted=f"at least {self._keys['num_queries']}: larger shorter_side and "
                "longest_side, or a picture that is less narrow",
            )
        return picture


def _library_version() -> str:
    try:
        return version(DISTRIBUTION)
    except PackageNotFoundError as error:
        raise ModelError(
            f"the package {DISTRIBUTION!r} is not installed", accepted=f"pip install {DISTRIBUTION}"
        ) from error
