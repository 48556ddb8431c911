"""What several protocols count in the same way."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from gvr_core.protocols.base import BoolArray, Box, Metrics

OVERLAPS = (0.25, 0.5)
"""An object counts as found where its IoU is strictly above these."""


def found_at(overlap: float) -> Metrics:
    """``acc_at_0.25`` and ``acc_at_0.5`` of an IoU."""
    return {f"acc_at_{least:g}": float(overlap > least) for least in OVERLAPS}


def in_boxes(shape: tuple[int, ...], boxes: Iterable[Box]) -> BoolArray:
    """The pixels of a picture that lie in any of some boxes.

    Args:
        shape: Height and width, pixels.
        boxes: Corners in pixels, both ends inclusive, in either order. Labels are drawn from any
            corner, and LangSplat's evaluator takes the smaller coordinate as the lower end too.

    Returns:
        (H, W) bool.
    """
    rows, columns = np.arange(shape[0])[:, None], np.arange(shape[1])
    inside = np.zeros((shape[0], shape[1]), np.bool_)
    for x0, y0, x1, y1 in boxes:
        inside |= ((rows >= min(y0, y1)) & (rows <= max(y0, y1))) & (
            (columns >= min(x0, x1)) & (columns <= max(x0, x1))
        )
    return inside


def pixel_in_boxes(pixel: tuple[float, float] | None, boxes: Iterable[Box]) -> bool:
    """Whether the pixel that a point (x, y) falls in lies in any box; no point is a miss."""
    if pixel is None:
        return False
    column, row = np.floor(pixel)
    return any(
        min(x0, x1) <= column <= max(x0, x1) and min(y0, y1) <= row <= max(y0, y1)
        for x0, y0, x1, y1 in boxes
    )
