"""The two protocols on the LERF-OVS labels: LangSplat's in 2D, and OpenGaussian's in 3D.

``lerf_ovs.langsplat_2d/1``
    Relevancy maps, where they are given, go through LangSplat's whole post-processing
    (:mod:`gvr_core.protocols.relevancy`). Other predictions have no relevancy; theirs is read as
    the share of a pixel's colour, cut at 0.5 and located at the peak of its 30 x 30 mean.

``lerf_ovs.opengaussian_3d/1``
    The chosen Gaussians drawn alone, with nothing in front of them.

Both take a prompt's labels of a view together: the union of their masks, and any of their boxes.
"""

from __future__ import annotations

import numpy as np

from gvr_core.metrics import BINARISE_AT, iou
from gvr_core.protocols.base import (
    BoolArray,
    FloatArray,
    Metrics,
    ProtocolSpec,
    ViewPrediction,
    ViewTruth,
)
from gvr_core.protocols.checks import check_pair
from gvr_core.protocols.overlap import found_at, in_boxes, pixel_in_boxes
from gvr_core.protocols.relevancy import Float64Array, box_mean, peaks, segment

SOFT_ABOVE = BINARISE_AT
"""A prediction without relevancy maps claims the pixels that owe it more than this share."""
ISOLATED_ABOVE = 0.7
"""OpenGaussian writes the silhouette of the chosen Gaussians where their opacity is above this."""
GREY_ABOVE = 10 / 255
"""OpenGaussian's evaluator takes grey values above 10 of a given picture as foreground."""


def langsplat_2d(prediction: ViewPrediction, truth: ViewTruth) -> Metrics | None:
    """Score one prompt in one view as LangSplat does.

    The source divides by an empty union; here a pair with neither truth nor prediction is left
    out. It also hits with a relevancy of zero everywhere, whose maxima are all pixels; here a
    prediction that says nothing misses. Otherwise each maximum counts, and one of them in one of
    the boxes is enough, as in the source.

    Returns:
        ``iou``; ``acc``, whether a maximum of the 30 x 30 mean lies in a box; ``acc_center``,
        whether the projected L_3D does; ``acc_at_0.25`` and ``acc_at_0.5``, whether the IoU is
        strictly above; ``pixel_acc``, the share of pixels labelled right. None where truth and
        predicted mask are both empty.

    Raises:
        DatasetError: for maps that are not of the truth's size, or not finite.
    """
    check_pair(prediction, truth)
    if prediction.relevancy is None:
        mask, mean = prediction.soft > SOFT_ABOVE, box_mean(prediction.soft)
        says = bool(prediction.soft.any())
    else:
        mask, mean = _from_relevancy(prediction.relevancy)
        says = bool(prediction.relevancy.any())
    if not mask.any() and not truth.mask.any():
        return None
    overlap = iou(mask, truth.mask)
    hit = says and bool((peaks(mean) & in_boxes(mask.shape, truth.boxes)).any())
    return {
        "acc": float(hit),
        "iou": overlap,
        "acc_center": float(pixel_in_boxes(prediction.pixel, truth.boxes)),
        **found_at(overlap),
        "pixel_acc": float(np.mean(mask == truth.mask)),
    }


def opengaussian_3d(prediction: ViewPrediction, truth: ViewTruth) -> Metrics:
    """Score one prompt in one view as OpenGaussian does.

    The target's Gaussians drawn alone are cut at an opacity of 0.7; a picture that was given is
    taken as its silhouette and cut at grey 10 of 255. Nothing given scores 0, and so does an
    empty union, as in the source. Relevancy maps choose no Gaussians: nothing is defined for them.

    Returns:
        ``iou``, ``acc_at_0.25`` and ``acc_at_0.5`` (strictly above); nothing for relevancy maps.

    Raises:
        DatasetError: for maps that are not of the truth's size, or not finite.
    """
    check_pair(prediction, truth)
    if prediction.isolated is not None:
        mask = prediction.isolated > ISOLATED_ABOVE
    elif prediction.relevancy is None:
        mask = prediction.soft > GREY_ABOVE
    else:
        return {}
    overlap = iou(mask, truth.mask)
    return {"iou": overlap, **found_at(overlap)}


def _from_relevancy(maps: FloatArray) -> tuple[BoolArray, Float64Array]:
    """The mask (H, W), and the mean (H, W) to locate in, each of the level that it chooses."""
    means = np.stack([box_mean(level) for level in maps])
    # The source chooses twice: the mask by the blended peaks, the place by those of the means.
    located: Float64Array = means[int(np.argmax(means.max(axis=(1, 2))))]
    return segment(maps, means), located


LANGSPLAT_2D = ProtocolSpec(
    id="lerf_ovs.langsplat_2d/1",
    about="rendered masks and relevancy peaks against the LERF-OVS labels, as LangSplat",
    source="minghanqin/LangSplat: eval/evaluate_iou_loc.py, eval/utils.py",
    mean="flat",
    headline=(("acc", "Acc"), ("iou", "mIoU")),
    score_pair=langsplat_2d,
)

OPENGAUSSIAN_3D = ProtocolSpec(
    id="lerf_ovs.opengaussian_3d/1",
    about="the chosen Gaussians drawn alone against the LERF-OVS labels, as OpenGaussian",
    source="yanmin-wu/OpenGaussian: render_lerf_by_text.py, scripts/compute_lerf_iou.py",
    mean="flat",
    headline=(("iou", "mIoU"), ("acc_at_0.25", "Acc@0.25"), ("acc_at_0.5", "Acc@0.5")),
    score_pair=opengaussian_3d,
    needs_isolated=True,
)
