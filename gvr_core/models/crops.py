"""Patches cut out of a frame as square pictures, the way classifiers want them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gvr_core.errors import ModelError
from gvr_core.models.base import FloatArray, Mask

CropMode = Literal["masked", "bbox", "context"]
"""What is shown of a patch: only its own pixels, its whole box, or the box and what is around."""

CONTEXT_FACTOR = 1.5
"""Side of the ``"context"`` box over the side of the tight box."""

GREY = 127
"""Fills what is not shown. It is the zero of networks that take (value - 127) / 128."""

Colour = tuple[int, int, int]
"""Red, green and blue, 0 to 255."""

GREY_FILL: Colour = (GREY, GREY, GREY)

Interpolation = Literal["bicubic", "bilinear"]
"""How pictures are resized; both with antialiasing."""

_RESAMPLING = {
    "bicubic": Image.Resampling.BICUBIC,
    "bilinear": Image.Resampling.BILINEAR,
}


def crop_patch(
    rgb8: NDArray[np.uint8],
    mask: Mask,
    mode: CropMode,
    size: int,
    fill: Colour = GREY_FILL,
    interpolation: Interpolation = "bicubic",
) -> NDArray[np.uint8]:
    """One patch as a square picture; shorter sides are padded, never stretched.

    Args:
        rgb8: (H, W, 3) uint8, the whole picture.
        mask: The patch; an empty one gives a picture of the filling colour.
        mode: What is shown of it.
        size: Side of the result, pixels.
        fill: Colour of what is not shown.
        interpolation: How the square is resized.

    Returns:
        (size, size, 3) uint8.
    """
    square = _square(rgb8, mask, mode, fill)
    if square is None:
        return np.full((size, size, 3), fill, np.uint8)
    return np.asarray(Image.fromarray(square).resize((size, size), _RESAMPLING[interpolation]))


def _square(
    rgb8: NDArray[np.uint8], mask: Mask, mode: CropMode, fill: Colour
) -> NDArray[np.uint8] | None:
    """What is shown of a patch in the picture's own pixels; None where the patch is empty."""
    height, width = rgb8.shape[:2]
    x0, y0, x1, y1 = mask.box
    if x1 <= x0:
        return None
    if mode == "context":
        grow_x = round((x1 - x0) * (CONTEXT_FACTOR - 1) / 2)
        grow_y = round((y1 - y0) * (CONTEXT_FACTOR - 1) / 2)
        x0, x1 = max(0, x0 - grow_x), min(width, x1 + grow_x)
        y0, y1 = max(0, y0 - grow_y), min(height, y1 + grow_y)
    content = rgb8[y0:y1, x0:x1]
    if mode == "masked":
        content = np.where(mask.pixels[y0:y1, x0:x1, None], content, np.array(fill, np.uint8))
    side = max(x1 - x0, y1 - y0)
    square = np.full((side, side, 3), fill, np.uint8)
    top, left = (side - content.shape[0]) // 2, (side - content.shape[1]) // 2
    square[top : top + content.shape[0], left : left + content.shape[1]] = content
    return square


def crop_patches(
    rgb: FloatArray,
    masks: Sequence[Mask],
    mode: CropMode,
    size: int,
    fill: Colour = GREY_FILL,
    interpolation: Interpolation = "bicubic",
) -> NDArray[np.uint8]:
    """All patches of a frame as square pictures.

    Args:
        rgb: (H, W, 3) colour in [0, 1]; values outside are clipped.
        masks: The m patches, each of the picture's size.
        mode: What is shown of each.
        size: Side of the results, pixels.
        fill: Colour of what is not shown.
        interpolation: How the squares are resized.

    Returns:
        (m, size, size, 3) uint8.

    Raises:
        ModelError: if a mask is not of the picture's size.
    """
    rgb8 = to_uint8(rgb)
    pictures = np.empty((len(masks), size, size, 3), np.uint8)
    for i, mask in enumerate(masks):
        if mask.pixels.shape != rgb8.shape[:2]:
            raise ModelError(
                f"mask {i} has shape {mask.pixels.shape}", accepted=f"shape {rgb8.shape[:2]}"
            )
        pictures[i] = crop_patch(rgb8, mask, mode, size, fill, interpolation)
    return pictures


def to_uint8(rgb: FloatArray) -> NDArray[np.uint8]:
    """Colour in [0, 1] as whole numbers 0 to 255, rounded; values outside are clipped."""
    return np.rint(np.clip(rgb, 0, 1) * 255).astype(np.uint8)
