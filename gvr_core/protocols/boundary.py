"""Overlap of the boundaries of two masks.

Source: Cheng, Girshick, Dollár, Berg, Kirillov: Boundary IoU (CVPR 2021), in the form of
Gaussian Grouping ``script/eval_lerf_mask.py`` (``mask_to_boundary``, ``boundary_iou``).
"""

from __future__ import annotations

import cv2
import numpy as np

from gvr_core.metrics import iou
from gvr_core.protocols.base import BoolArray

BOUNDARY_RATIO = 0.02
"""Width of the boundary as a share of the picture's diagonal."""


def boundary_width(height: int, width: int) -> int:
    """Width of the boundary in a picture of this size, pixels; at least 1, and 25 at 988 x 731."""
    # round() takes halves to the even number, as the source's does.
    return max(1, round(BOUNDARY_RATIO * float(np.sqrt(height**2 + width**2))))


def boundary(mask: BoolArray) -> BoolArray:
    """The pixels (H, W) of a mask that are at most :func:`boundary_width` from what is not in it.

    Distances are the larger of the two along the axes: eroding by 3 x 3 once for each pixel of
    width is eroding by one square. Everything beyond the picture is outside of the mask.
    """
    side = 2 * boundary_width(*mask.shape) + 1
    inner = cv2.erode(
        mask.astype(np.uint8),
        np.ones((side, side), np.uint8),
        borderType=cv2.BORDER_CONSTANT,
        borderValue=0,
    )
    result: BoolArray = mask & (inner == 0)
    return result


def boundary_iou(prediction: BoolArray, truth: BoolArray) -> float:
    """IoU of the boundaries of two masks (H, W); 0 where both masks are empty."""
    return iou(boundary(prediction), boundary(truth))
