"""Our own protocols (:mod:`gvr_core.metrics`) in the form of all others."""

from __future__ import annotations

from gvr_core.metrics import FLAGS_3D, IN_SCENE_2D, REFUSAL, in_scene_2d
from gvr_core.protocols.base import Metrics, ProtocolSpec, ViewPrediction, ViewTruth
from gvr_core.protocols.checks import check_pair


def in_scene(prediction: ViewPrediction, truth: ViewTruth) -> Metrics | None:
    """Score one prompt in one view by ``gvr.in_scene_2d/1``.

    Its box is the mask's, whatever boxes the labels have: it was made for exact masks.

    Returns:
        The metrics of :func:`gvr_core.metrics.in_scene_2d`; None where the truth is empty, since
        the protocol is defined for views that show the object.

    Raises:
        DatasetError: for maps that are not of the truth's size, or not finite.
    """
    check_pair(prediction, truth)
    if not truth.mask.any():
        return None
    return in_scene_2d(prediction.soft, truth.mask, prediction.pixel)


OWN_IN_SCENE_2D = ProtocolSpec(
    id=IN_SCENE_2D,
    about="the target's share of each pixel's colour, occluded by the scene, against exact masks",
    source="gvr_core/metrics.py: in_scene_2d",
    mean="flat",
    headline=(("acc_peak", "Acc"), ("iou", "mIoU")),
    score_pair=in_scene,
)

OWN_FLAGS_3D = ProtocolSpec(
    id=FLAGS_3D,
    about="the chosen Gaussians against exact labels of Gaussians",
    source="gvr_core/metrics.py: flags_3d",
    mean="flat",
    headline=(("iou", "3D IoU"),),
)

OWN_REFUSAL = ProtocolSpec(
    id=REFUSAL,
    about="whether objects that are there are found, and others refused",
    source="gvr_core/metrics.py: refusal",
    mean="flat",
    headline=(("correct", "refusal"),),
)
