"""The evaluation protocols, each a named and versioned function.

``gvr.in_scene_2d/1``
    The target Gaussians are drawn white and all others black, both with their full opacity, so
    that occluders occlude; the red channel of that render is the soft prediction. Per (query,
    view): ``iou`` of its pixels above 0.5 with the exact mask; ``acc_peak``: a maximum of its
    30 x 30 box mean lies in the truth's box (the localisation accuracy of LERF and LangSplat);
    ``acc_center``: the projected L_3D lies in the truth's box; ``acc_at_0.25``, ``acc_at_0.5``:
    IoU strictly above; ``pixel_acc``: share of pixels labelled right.

``flags_3d/1``
    Over Gaussians, per query: ``iou``, ``precision``, ``recall`` of the flags; the distance of
    L_3D from the object's centre in scene units and in object radii; ``within_radius``.

``refusal/1``
    Per query: ``found``, and ``correct``: found where the object is there, refused where not.

An empty prediction scores 0, never nothing. A view that does not show the object has no truth:
it is left out by the caller, and counted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

IN_SCENE_2D = "gvr.in_scene_2d/1"
FLAGS_3D = "flags_3d/1"
REFUSAL = "refusal/1"

BINARISE_AT = 0.5
"""A pixel belongs to the prediction where the dyed share of its colour is above this."""
PEAK_WINDOW = 30
"""Side of the box mean of LangSplat's localisation, pixels; an even window reaches one further
to the left and up, as cv2.filter2D's does."""
RADIUS_PERCENTILE = 90.0
"""An object's radius is this percentile of its Gaussians' distances from their centre."""

BoolArray = NDArray[np.bool_]


def iou(prediction: BoolArray, truth: BoolArray) -> float:
    """Intersection over union of two boolean arrays of one shape; 0 where both are empty."""
    union = np.count_nonzero(prediction | truth)
    return float(np.count_nonzero(prediction & truth) / union) if union else 0.0


def truth_box(truth: BoolArray) -> tuple[int, int, int, int]:
    """Box (x0, y0, x1, y1) of a mask (H, W), ends inclusive, as the LERF labels have it."""
    rows = np.flatnonzero(truth.any(axis=1))
    columns = np.flatnonzero(truth.any(axis=0))
    return int(columns[0]), int(rows[0]), int(columns[-1]), int(rows[-1])


def peak_in_box(soft: NDArray[np.float32], box: tuple[int, int, int, int]) -> bool:
    """Whether a maximum of the box-averaged soft prediction lies in the box.

    Source: LangSplat ``eval/evaluate_iou_loc.py``: 30 x 30 mean with reflected border, all
    pixels equal to the maximum are candidates, one of them in the box is enough. A prediction
    that is zero everywhere has no maximum worth the name and misses.

    Args:
        soft: (H, W) >= 0.
        box: (x0, y0, x1, y1) inclusive.
    """
    if not soft.any():
        return False
    mean = ndimage.uniform_filter(soft.astype(np.float64), PEAK_WINDOW, mode="mirror")
    # The filter runs on sums, so equal means differ in the last bits.
    rows, columns = np.nonzero(mean >= mean.max() * (1 - 1e-9))
    x0, y0, x1, y1 = box
    return bool(((columns >= x0) & (columns <= x1) & (rows >= y0) & (rows <= y1)).any())


def in_scene_2d(
    soft: NDArray[np.float32], truth: BoolArray, pixel: tuple[float, float] | None
) -> dict[str, float]:
    """Protocol ``gvr.in_scene_2d/1`` for one query in one view.

    Args:
        soft: (H, W) share of each pixel's colour that comes from the target Gaussians.
        truth: (H, W) exact mask, not empty.
        pixel: The projected L_3D (x, y); None where there is none, or it is behind the camera.
    """
    prediction = soft > BINARISE_AT
    overlap = iou(prediction, truth)
    box = truth_box(truth)
    hit = False
    if pixel is not None:
        column, row = np.floor(pixel[0]), np.floor(pixel[1])
        hit = bool(box[0] <= column <= box[2] and box[1] <= row <= box[3])
    return {
        "iou": overlap,
        "acc_peak": float(peak_in_box(soft, box)),
        "acc_center": float(hit),
        "acc_at_0.25": float(overlap > 0.25),
        "acc_at_0.5": float(overlap > 0.5),
        "pixel_acc": float(np.mean(prediction == truth)),
    }


def object_extent(means: NDArray[np.float32]) -> tuple[NDArray[np.float64], float]:
    """Centre and radius of an object from its Gaussians.

    Args:
        means: (n, 3), world frame, n >= 1.

    Returns:
        The median of the centres (3,), and the 90th percentile of their distances from it.
    """
    centre = np.median(means.astype(np.float64), axis=0)
    distances = np.linalg.norm(means - centre, axis=1)
    return centre, float(np.percentile(distances, RADIUS_PERCENTILE))


def flags_3d(
    flags: BoolArray,
    truth: BoolArray,
    means: NDArray[np.float32],
    location: NDArray[np.float64] | None,
) -> dict[str, float]:
    """Protocol ``flags_3d/1`` for one query.

    Args:
        flags: (N,) predicted.
        truth: (N,) exact, at least one set.
        means: (N, 3) centres of all Gaussians.
        location: (3,) L_3D, or None; then ``within_radius`` is 0 and the error is left out.
    """
    hits = int(np.count_nonzero(flags & truth))
    predicted = int(np.count_nonzero(flags))
    values = {
        "iou": iou(flags, truth),
        "precision": hits / predicted if predicted else 0.0,
        "recall": hits / int(np.count_nonzero(truth)),
        "within_radius": 0.0,
    }
    if location is not None:
        centre, radius = object_extent(means[truth])
        error = float(np.linalg.norm(location - centre))
        values["location_error"] = error
        if radius > 0:
            values["location_error_radii"] = error / radius
        values["within_radius"] = float(error <= radius)
    return values


def refusal(found: bool, absent: bool) -> dict[str, float]:
    """Protocol ``refusal/1`` for one query.

    Args:
        found: What the method said.
        absent: Whether the object is known not to be in the scene.
    """
    return {"found": float(found), "correct": float(found != absent)}
