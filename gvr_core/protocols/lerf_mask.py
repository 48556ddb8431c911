"""The protocol of the LERF-Mask labels: Gaussian Grouping's, strict and as it was published.

Its evaluator passes over prompts without a picture of the prediction, so that a wrong file name
raises the score. ``lerf_mask.gg/1`` scores these 0; ``lerf_mask.gg_compat/1`` leaves them out as
the source does, for comparison with numbers that were made so.
"""

from __future__ import annotations

from gvr_core.metrics import iou
from gvr_core.protocols.base import Metrics, ProtocolSpec, ViewPrediction, ViewTruth
from gvr_core.protocols.boundary import boundary_iou
from gvr_core.protocols.checks import check_pair

GREY_ABOVE = 128 / 255
"""The evaluator takes grey values above 128 as foreground; so are rendered predictions."""


def gg(prediction: ViewPrediction, truth: ViewTruth) -> Metrics | None:
    """Score one prompt in one view as Gaussian Grouping does, and 0 where nothing was given.

    The source divides by an empty union; here a pair with neither truth nor prediction is left
    out. It resizes predictions of another size; here they are refused.

    Returns:
        ``iou``, and ``boundary_iou`` (:mod:`gvr_core.protocols.boundary`). None where truth and
        predicted mask are both empty, though something was given.

    Raises:
        DatasetError: for maps that are not of the truth's size, or not finite.
    """
    check_pair(prediction, truth)
    if prediction.missing:
        return {"iou": 0.0, "boundary_iou": 0.0}
    mask = prediction.soft > GREY_ABOVE
    if not mask.any() and not truth.mask.any():
        return None
    return {"iou": iou(mask, truth.mask), "boundary_iou": boundary_iou(mask, truth.mask)}


def gg_compat(prediction: ViewPrediction, truth: ViewTruth) -> Metrics | None:
    """As :func:`gg`, but None where nothing was given."""
    return None if prediction.missing else gg(prediction, truth)


_SOURCE = "lkeab/gaussian-grouping: script/eval_lerf_mask.py"
_HEADLINE = (("iou", "mIoU"), ("boundary_iou", "mBIoU"))

GG = ProtocolSpec(
    id="lerf_mask.gg/1",
    about="masks and their boundaries against the LERF-Mask labels, as Gaussian Grouping; "
    "missing predictions score 0",
    source=_SOURCE,
    mean="class",
    headline=_HEADLINE,
    score_pair=gg,
)

GG_COMPAT = ProtocolSpec(
    id="lerf_mask.gg_compat/1",
    about="masks and their boundaries against the LERF-Mask labels, as Gaussian Grouping; "
    "missing predictions are passed over",
    source=_SOURCE,
    mean="class",
    headline=_HEADLINE,
    score_pair=gg_compat,
)
