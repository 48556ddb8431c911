"""LangSplat's way from relevancy maps to a mask and to a place.

Source: LangSplat ``eval/evaluate_iou_loc.py`` (``activate_stream``, ``lerf_localization``) and
``eval/utils.py`` (``smooth``). The arithmetic here is in double precision. The source's is in
single, where the transform behind its mean leaves noise of about 1e-7: that decides which pixel of
a plateau is the largest, and a map that is the same everywhere becomes a random mask when it is
stretched to [0, 1]. Here a plateau is a tie, and such a map gives no mask.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gvr_core.metrics import PEAK_WINDOW
from gvr_core.protocols.base import BoolArray

MASK_THRESHOLD = 0.4
"""On the upper half of the stretched map, stretched again to [0, 1]: 0.7 of the whole."""
STRETCH_EPSILON = 1e-9
VOTE_REACH = 3
"""The 7 x 7 vote looks this far to each side."""
TIE = 1e-9
"""Means within this share of the largest one are equal to it; they are sums, rounded."""

Float64Array = NDArray[np.float64]


def box_mean(values: NDArray[np.floating]) -> Float64Array:
    """Mean of each pixel's 30 x 30 surroundings.

    The window is even and reaches one further to the left and up: from x - 15 to x + 14. Beyond
    the border the picture is mirrored without repeating its last pixel (OpenCV's default).

    Args:
        values: (H, W).
    """
    mean = cv2.boxFilter(
        values.astype(np.float64),
        -1,
        (PEAK_WINDOW, PEAK_WINDOW),
        anchor=(PEAK_WINDOW // 2, PEAK_WINDOW // 2),
        borderType=cv2.BORDER_REFLECT_101,
    )
    return np.asarray(mean, dtype=np.float64)


def majority(mask: BoolArray) -> BoolArray:
    """What most pixels of each pixel's 7 x 7 surroundings say; False on a tie.

    The source's window ends before the last row and the last column of the picture, so their
    pixels are given a value but have no vote themselves. A picture of a single row or column,
    on which the source fails, has no votes at all and becomes False.

    Args:
        mask: (H, W).
    """
    height, width = mask.shape
    voters = mask.astype(np.uint8)
    voters[-1] = 0
    voters[:, -1] = 0
    side = 2 * VOTE_REACH + 1  # 49 votes at most, so that uint8 holds their number
    ayes = cv2.boxFilter(
        voters, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT
    ).astype(np.int32)
    result: BoolArray = 2 * ayes > _window(height)[:, None] * _window(width)
    return result


def _window(length: int) -> NDArray[np.int32]:
    """Number of voters along one axis for each position (length,)."""
    at = np.arange(length, dtype=np.int32)
    last = np.minimum(at + VOTE_REACH + 1, length - 1)
    voters: NDArray[np.int32] = np.maximum(last - np.maximum(at - VOTE_REACH, 0), 0)
    return voters


def threshold_map(values: NDArray[np.floating], mean: Float64Array) -> tuple[BoolArray, float]:
    """The mask of one relevancy map.

    Args:
        values: (H, W) relevancy.
        mean: Its :func:`box_mean`.

    Returns:
        The mask (H, W), and the peak of the map's blend with its mean, by which a level is chosen.
    """
    blend = 0.5 * (mean + values)
    stretched = blend - blend.min()
    stretched /= stretched.max() + STRETCH_EPSILON
    upper = np.clip(2.0 * stretched - 1.0, 0.0, 1.0)
    return majority(upper > MASK_THRESHOLD), float(blend.max())


def segment(maps: NDArray[np.floating], means: Float64Array) -> BoolArray:
    """The mask (H, W) of the level with the largest blended peak, the first of equal ones.

    Args:
        maps: (L, H, W) relevancy.
        means: (L, H, W) their :func:`box_mean`.
    """
    masks, peaks = zip(*map(threshold_map, maps, means), strict=True)
    chosen: BoolArray = masks[int(np.argmax(peaks))]
    return chosen


def peaks(mean: Float64Array) -> BoolArray:
    """The pixels (H, W) at which a mean has its maximum: more than one where there are ties."""
    largest = float(mean.max())
    return mean >= largest - TIE * abs(largest)
