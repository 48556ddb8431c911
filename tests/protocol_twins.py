"""The protocols a second time, written from their definitions and sharing nothing with them.

Loops over pixels, other libraries' calls, and the evaluators' own order of steps. Slow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from sklearn.metrics import accuracy_score, jaccard_score

from gvr_core.protocols.base import Box, ViewPrediction, ViewTruth


def jaccard(a: np.ndarray, b: np.ndarray) -> float:
    """scikit-learn's index of the pixels that are set; 0 where none are."""
    pixels = a.astype(int).ravel(), b.astype(int).ravel()
    return float(jaccard_score(*pixels, pos_label=1, zero_division=0))


def vote(mask: np.ndarray) -> np.ndarray:
    """7 x 7 majority, pixel by pixel; windows end before the last row and column."""
    height, width = mask.shape
    result = np.zeros(mask.shape, bool)
    for y in range(height):
        for x in range(width):
            window = mask[max(0, y - 3) : min(y + 4, height - 1)]
            window = window[:, max(0, x - 3) : min(x + 4, width - 1)]
            ayes = int(window.sum())
            result[y, x] = ayes > window.size - ayes
    return result


def mean_30(values: np.ndarray) -> np.ndarray:
    """The mean that LangSplat asks OpenCV for."""
    return cv2.filter2D(values.astype(np.float64), -1, np.full((30, 30), 1 / 900))


def located(mean: np.ndarray, boxes: Sequence[Box]) -> bool:
    """Whether one of the largest pixels lies in one of the boxes."""
    largest = mean.max()
    for y, x in np.argwhere(np.isclose(mean, largest, rtol=1e-9, atol=0)):
        for box in boxes:
            (left, right), (top, bottom) = sorted(box[0::2]), sorted(box[1::2])
            if left <= x <= right and top <= y <= bottom:
                return True
    return False


def langsplat_2d(prediction: ViewPrediction, truth: ViewTruth) -> dict[str, float] | None:
    if prediction.relevancy is None:
        chosen = prediction.soft > 0.5
        place = mean_30(prediction.soft)
        silent = not prediction.soft.any()
    else:
        best_blend = best_mean = -math.inf
        for level in prediction.relevancy:
            mean = mean_30(level)
            blend = (mean + level) / 2
            if blend.max() > best_blend:
                best_blend = blend.max()
                unit = (blend - blend.min()) / ((blend - blend.min()).max() + 1e-9)
                chosen = vote((unit * 2 - 1).clip(0, 1) > 0.4)
            if mean.max() > best_mean:
                best_mean, place = mean.max(), mean
        silent = not prediction.relevancy.any()
    if not (chosen | truth.mask).any():
        return None
    overlap = jaccard(truth.mask, chosen)
    hit = False
    if prediction.pixel is not None:
        x, y = (math.floor(v) for v in prediction.pixel)
        for a, b, c, d in truth.boxes:
            hit = hit or (min(a, c) <= x <= max(a, c) and min(b, d) <= y <= max(b, d))
    return {
        "acc": 0.0 if silent else float(located(place, truth.boxes)),
        "iou": overlap,
        "acc_center": float(hit),
        "acc_at_0.25": 1.0 if overlap > 0.25 else 0.0,
        "acc_at_0.5": 1.0 if overlap > 0.5 else 0.0,
        "pixel_acc": float(accuracy_score(truth.mask.ravel(), chosen.ravel())),
    }


def opengaussian_3d(prediction: ViewPrediction, truth: ViewTruth) -> dict[str, float]:
    if prediction.missing:
        overlap = 0.0
    else:
        if prediction.isolated is not None:  # what is written, then read again
            seen = np.where(prediction.isolated > np.float32(0.7), 255, 0) > 10
        else:
            seen = prediction.soft > np.float32(10) / np.float32(255)
        union = int((seen | truth.mask).sum())
        overlap = int((seen & truth.mask).sum()) / union if union else 0.0
    return {
        "iou": overlap,
        "acc_at_0.25": float(np.mean(np.array([overlap]) > 0.25)),
        "acc_at_0.5": float(np.mean(np.array([overlap]) > 0.5)),
    }


def rim(mask: np.ndarray) -> np.ndarray:
    """The boundary as Gaussian Grouping takes it: pad, erode often by 3 x 3, cut, subtract."""
    height, width = mask.shape
    times = max(round(0.02 * math.hypot(height, width)), 1)
    padded = cv2.copyMakeBorder(mask.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    for _ in range(times):
        padded = cv2.erode(padded, np.ones((3, 3), np.uint8))
    return mask & (padded[1:-1, 1:-1] == 0)


def rim_by_distance(mask: np.ndarray) -> np.ndarray:
    """The boundary by its definition: near to a pixel that is not in the mask, or to the edge."""
    height, width = mask.shape
    reach = max(round(0.02 * math.hypot(height, width)), 1)
    result = np.zeros(mask.shape, bool)
    for y in range(height):
        for x in range(width):
            for i in range(y - reach, y + reach + 1):
                for j in range(x - reach, x + reach + 1):
                    inside = 0 <= i < height and 0 <= j < width and mask[i, j]
                    result[y, x] |= mask[y, x] and not inside
    return result


def gg(prediction: ViewPrediction, truth: ViewTruth, strict: bool) -> dict[str, float] | None:
    if prediction.missing:
        return {"iou": 0.0, "boundary_iou": 0.0} if strict else None
    seen = prediction.soft > np.float32(128) / np.float32(255)
    if not (seen | truth.mask).any():
        return None
    return {
        "iou": jaccard(truth.mask, seen),
        "boundary_iou": jaccard(rim(truth.mask), rim(seen)),
    }


def binary(prediction: ViewPrediction, truth: ViewTruth) -> dict[str, float] | None:
    seen = np.array([value > 0.5 for value in prediction.soft.ravel().tolist()])
    real = truth.mask.ravel()
    both = sum(map(bool, seen & real))
    either = sum(map(bool, seen | real))
    return {"iou": both / either} if either else None


def exclusive(
    predictions: Mapping[str, ViewPrediction], truths: Mapping[str, ViewTruth]
) -> dict[str, dict[str, float]]:
    names = sorted(truths)
    rows: list[list[int]] = []
    labels = np.stack([truths[name].mask.ravel() for name in names], axis=1).astype(int)
    scores = np.stack([predictions[name].soft.ravel() for name in names], axis=1)
    for pixel in scores.tolist():
        first = pixel.index(max(pixel))
        rows.append([int(i == first) for i in range(len(names))])
    onehot: Any = np.array(rows)
    if len(names) == 1:  # scikit-learn takes one column for a question of yes or no
        overlaps = [jaccard(labels, onehot)]
    else:
        overlaps = jaccard_score(labels, onehot, average=None, zero_division=0).tolist()
    accuracy = float(accuracy_score(labels, onehot))
    return {
        name: {"iou": overlap, "pixel_acc": accuracy}
        for name, overlap in zip(names, overlaps, strict=True)
    }


def in_scene_2d(prediction: ViewPrediction, truth: ViewTruth) -> dict[str, float] | None:
    if not truth.mask.any():
        return None
    ys, xs = np.where(truth.mask)
    box = (float(xs.min()), float(ys.min()), float(xs.max()), float(ys.max()))
    boxed = ViewTruth(truth.mask, (box,))
    values = langsplat_2d(ViewPrediction(prediction.soft, pixel=prediction.pixel), boxed)
    if values is None:
        return None
    values["acc_peak"] = values.pop("acc")
    return values
