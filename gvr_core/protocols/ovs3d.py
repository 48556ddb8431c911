"""The two protocols on the 3D-OVS labels: each class by itself, or all classes for each pixel.

``ovs3d.binary/1``
    A mask for each class, as methods that answer one prompt at a time give it. LangSplat's own
    evaluator was never published; this is the form of those that repeat it.

``ovs3d.exclusive/1``
    The data set's own: the classes of a scene compete, and each pixel goes to one of them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gvr_core.errors import DatasetError
from gvr_core.metrics import BINARISE_AT, iou
from gvr_core.protocols.base import Metrics, ProtocolSpec, ViewPrediction, ViewTruth
from gvr_core.protocols.checks import check_pair

SOFT_ABOVE = BINARISE_AT
"""A class claims the pixels that owe it more than this share of their colour."""


def binary(prediction: ViewPrediction, truth: ViewTruth) -> Metrics | None:
    """Score one class in one view, whatever the others say.

    Returns:
        ``iou``; None where truth and predicted mask are both empty.

    Raises:
        DatasetError: for maps that are not of the truth's size, or not finite.
    """
    check_pair(prediction, truth)
    mask = prediction.soft > SOFT_ABOVE
    if not mask.any() and not truth.mask.any():
        return None
    return {"iou": iou(mask, truth.mask)}


def exclusive(
    predictions: Mapping[str, ViewPrediction], truths: Mapping[str, ViewTruth]
) -> dict[str, Metrics | None]:
    """Score all classes of a view together, each pixel given to its largest soft score.

    Equal scores go to the class that sorts first, so pixels that no class claims do too: there is
    no class for nothing. A class that neither the truth nor the prediction has scores 0 as in the
    source, whose Jaccard index is scikit-learn's. A missing prediction claims no pixel.

    Args:
        predictions: Class -> prediction.
        truths: The same classes -> truth. Masks may overlap, and may leave pixels without a class.

    Returns:
        Class -> ``iou``, and ``pixel_acc``: the share of the picture's pixels that have one label
        and were given to it; those with none or several are wrong. It belongs to the whole
        picture and stands with each of its classes. All pictures of this data set are labelled
        for all classes, so its mean over classes and views is the source's mean over pictures.

    Raises:
        DatasetError: where the two have not the same classes, or maps are not of one size, or not
            finite.
    """
    if predictions.keys() != truths.keys():
        raise DatasetError(
            f"predictions for {', '.join(sorted(predictions)) or 'nothing'}",
            accepted=f"the labelled classes {', '.join(sorted(truths)) or '(none)'}",
        )
    names = sorted(truths)
    for name in names:
        check_pair(predictions[name], truths[name])
    if len({truths[name].mask.shape for name in names}) > 1:
        raise DatasetError("masks of several sizes in one view", accepted="one size")
    if not names:
        return {}
    soft = [predictions[name].soft - np.float32(predictions[name].missing) for name in names]
    given = np.argmax(np.stack(soft), axis=0)
    if all(predictions[name].missing for name in names):
        given[:] = len(names)  # nobody's
    labels = np.zeros(given.shape, np.int32)
    right = np.zeros(given.shape, np.bool_)
    scores: dict[str, float] = {}
    for index, name in enumerate(names):
        claimed, mask = given == index, truths[name].mask
        scores[name] = iou(claimed, mask)
        labels += mask
        right |= claimed & mask
    pixel_acc = float(np.mean(right & (labels == 1)))
    return {name: {"iou": score, "pixel_acc": pixel_acc} for name, score in scores.items()}


BINARY = ProtocolSpec(
    id="ovs3d.binary/1",
    about="a mask for each class of 3D-OVS by itself, as those who repeat LangSplat's numbers",
    source="insait-institute/OccamLGS: eval/evaluate_iou_3dovs.py",
    mean="flat",
    headline=(("iou", "mIoU"),),
    score_pair=binary,
)

EXCLUSIVE = ProtocolSpec(
    id="ovs3d.exclusive/1",
    about="each pixel given to one class of 3D-OVS, as the data set's own evaluator",
    source="Kunhao-Liu/3D-OVS: renderer.py, dataLoader/llff.py",
    mean="flat",
    headline=(("iou", "mIoU"), ("pixel_acc", "pixel Acc")),
    score_view=exclusive,
)
