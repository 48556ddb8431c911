"""What every SAM does, whoever runs its networks: embed a picture once, decode many prompts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

if TYPE_CHECKING:
    import torch

PROMPT_BYTES = 128 * 2**20
"""Memory of one prompt while it is decoded: 4096 tokens through the decoder's layers, and three
masks at up to 1024 x 1024."""
MASK_THRESHOLD = 0.0
"""Logits above are inside (segment_anything.modeling.Sam.mask_threshold)."""


class SamSettings(BaseModel):
    """Settings of a SAM; the automatic masks' defaults are those of LangSplat.

    Source: LangSplat (CVPR 2024), preprocess.py: 32 points a side, predicted IoU 0.7, stability
    0.85, one crop layer, minimum area 100.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    points_per_side: int = Field(default=32, ge=1, le=256)
    """Prompts of the automatic masks: a grid of so many points a side."""
    pred_iou: float = Field(default=0.7, ge=0, le=1)
    """Masks whose quality, as the model itself predicts it, is not above this are dropped."""
    stability: float = Field(default=0.85, ge=0, le=1)
    """So are masks that change more than this when the cut through the logits moves."""
    stability_offset: float = Field(default=1.0, gt=0)
    """How far that cut moves up and down, logits."""
    nms_iou: float = Field(default=0.7, gt=0, le=1)
    """Of two masks of a level whose boxes overlap more than this, the better one is kept."""
    crop_layers: int = Field(default=1, ge=0, le=3)
    """Layer i looks again at 4^i overlapping crops of the picture, for what is small."""
    crop_overlap: float = Field(default=512 / 1500, ge=0, lt=1)
    """By how much crops overlap, as a share of the picture's shorter side."""
    crop_points_divisor: int = Field(default=1, ge=1)
    """The grid of layer i has points_per_side / divisor^i points a side."""
    min_area: int = Field(default=100, ge=0)
    """Holes and islands below so many pixels are closed and removed."""
    same_iou: float = Field(default=0.9, gt=0, le=1)
    """Of masks of two levels that overlap more than this, the coarser one is kept: the whole is
    often its own only part. 1 keeps all."""
    points_at_once: int = Field(default=64, ge=1)
    """Most prompts in a batch; changes no result."""


class SparseSamSettings(SamSettings):
    """The same with a grid that a processor can afford."""

    points_per_side: int = Field(default=12, ge=1, le=256)
    crop_layers: int = Field(default=0, ge=0, le=3)


@dataclass(frozen=True, eq=False)
class Embedding:
    """A picture as a SAM's decoder wants it."""

    features: Any
    """(1, 256, h, w) in whatever form the backend computes with."""
    picture_size: tuple[int, int]
    """Height and width of the picture, pixels."""
    input_size: tuple[int, int]
    """Height and width of the picture inside the network's square input, pixels."""
    n_bytes: int
    """Memory that the features take."""


class PromptableSam(Protocol):
    """The networks of a SAM. Decoding gives logits at a quarter of the input's resolution."""

    @property
    def name(self) -> str:
        """Which networks, with digests of their weights."""
        ...

    @property
    def side(self) -> int:
        """Side of the square input, pixels."""
        ...

    @property
    def device(self) -> torch.device:
        """Where logits are."""
        ...

    def embed(self, rgb8: NDArray[np.uint8]) -> Embedding:
        """Run the image encoder on an (H, W, 3) uint8 picture."""
        ...

    def decode_points(
        self, embedding: Embedding, points: NDArray[Any], labels: NDArray[np.int64]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Masks for each of b prompts of p points.

        A single point may mean a part of a part, a part, or the whole: three masks. Several are
        taken to be clear: one mask.

        Args:
            embedding: The picture.
            points: (b, p, 2) x and y in pixels of the picture.
            labels: (b, p) 1 for a point inside, 0 for one outside.

        Returns:
            Logits (b, k, h, w) and the predicted IoU of each mask (b, k); k is 3 or 1.
        """
        ...

    def decode_box(
        self, embedding: Embedding, box: NDArray[Any]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """The mask that a box frames.

        Args:
            embedding: The picture.
            box: (4,) x0, y0, x1, y1 in pixels of the picture.

        Returns:
            Logits (1, 1, h, w) and the predicted IoU (1, 1).
        """
        ...


def input_size(picture_size: tuple[int, int], side: int) -> tuple[int, int]:
    """Height and width of a picture whose longer side is scaled to the input's side."""
    from segment_anything.utils.transforms import ResizeLongestSide

    height, width = ResizeLongestSide.get_preprocess_shape(*picture_size, side)
    return int(height), int(width)


def input_coordinates(coordinates: NDArray[Any], embedding: Embedding) -> NDArray[Any]:
    """Coordinates (..., 2) of the picture in pixels of the network's input."""
    height, width = embedding.picture_size
    scale = np.array([embedding.input_size[1] / width, embedding.input_size[0] / height])
    scaled: NDArray[Any] = (coordinates * scale).astype(coordinates.dtype)
    return scaled


def picture_logits(logits: torch.Tensor, embedding: Embedding, side: int) -> torch.Tensor:
    """Logits of the decoder at the picture's resolution.

    Up to the input's square, the padding cut off, then to the picture's size, both bilinear, as
    segment_anything.modeling.Sam.postprocess_masks has it.

    Args:
        logits: (b, k, h, w) at a quarter of the input's resolution.
        embedding: The picture.
        side: Side of the input.

    Returns:
        (b, k, H, W).
    """
    from torch.nn.functional import interpolate

    square = interpolate(logits, (side, side), mode="bilinear", align_corners=False)
    height, width = embedding.input_size
    inside = square[..., :height, :width]
    return interpolate(inside, embedding.picture_size, mode="bilinear", align_corners=False)
