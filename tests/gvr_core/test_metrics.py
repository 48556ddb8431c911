"""The protocols, against second implementations written straight from their definitions."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gvr_core import metrics

SEEDS = st.integers(0, 2**32 - 1)


def slow_iou(a: np.ndarray, b: np.ndarray) -> float:
    both = either = 0
    for p, q in zip(a.ravel(), b.ravel(), strict=True):
        both += bool(p and q)
        either += bool(p or q)
    return both / either if either else 0.0


@given(SEEDS)
def test_iou_equals_counting(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.random((2, 9, 7)) > rng.random((2, 1, 1))
    assert metrics.iou(a, b) == pytest.approx(slow_iou(a, b), abs=1e-12)
    assert metrics.iou(a, b) == metrics.iou(b, a)
    assert metrics.iou(a, a) == (1.0 if a.any() else 0.0)


@given(SEEDS)
def test_the_peak_window_is_opencvs(seed: int) -> None:
    """LangSplat takes cv2.filter2D with ones / 900; the window is even, so its anchor matters."""
    rng = np.random.default_rng(seed)
    soft = np.zeros((64, 80), np.float32)
    row, column = rng.integers(0, 64), rng.integers(0, 80)
    soft[row : row + rng.integers(1, 30), column : column + rng.integers(1, 30)] = 1
    kernel = np.ones((30, 30), np.float64) / 900
    mean = cv2.filter2D(soft.astype(np.float64), -1, kernel)
    peaks = np.argwhere(mean >= mean.max() * (1 - 1e-9))
    box = tuple(int(v) for v in (*rng.integers(0, 40, 2), *rng.integers(40, 64, 2)))
    expected = any(box[0] <= x <= box[2] and box[1] <= y <= box[3] for y, x in peaks)
    assert metrics.peak_in_box(soft, box) == expected


def test_an_empty_prediction_misses_and_scores_zero() -> None:
    truth = np.zeros((40, 40), np.bool_)
    truth[10:20, 10:20] = True
    values = metrics.in_scene_2d(np.zeros((40, 40), np.float32), truth, None)
    assert values["iou"] == values["acc_peak"] == values["acc_center"] == 0
    assert values["pixel_acc"] == pytest.approx(0.9375)


def test_a_perfect_prediction() -> None:
    truth = np.zeros((90, 90), np.bool_)
    truth[20:60, 25:70] = True
    values = metrics.in_scene_2d(truth.astype(np.float32), truth, (40.0, 40.0))
    assert set(values.values()) == {1.0}


def test_accuracy_thresholds_are_strict() -> None:
    truth = np.zeros((40, 40), np.bool_)
    truth[:20, :20] = True
    prediction = np.zeros_like(truth)
    prediction[:10, :20] = True
    values = metrics.in_scene_2d(prediction.astype(np.float32), truth, None)
    assert values["iou"] == 0.5
    assert values["acc_at_0.5"] == 0.0
    assert values["acc_at_0.25"] == 1.0


@pytest.mark.parametrize(
    ("pixel", "hit"),
    [((5.0, 6.0), 1), ((8.99, 9.99), 1), ((9.0, 7.0), 0), ((4.99, 7.0), 0), ((6.0, 10.0), 0)],
)
def test_the_box_is_inclusive_of_its_last_pixel(pixel, hit) -> None:
    truth = np.zeros((20, 20), np.bool_)
    truth[6:10, 5:9] = True
    values = metrics.in_scene_2d(np.zeros((20, 20), np.float32), truth, pixel)
    assert values["acc_center"] == hit


@given(SEEDS)
def test_flags_3d_equals_counting(seed: int) -> None:
    rng = np.random.default_rng(seed)
    means = rng.normal(size=(50, 3)).astype(np.float32)
    flags, truth = rng.random((2, 50)) > 0.5
    truth[0] = True
    location = rng.normal(size=3)
    values = metrics.flags_3d(flags, truth, means, location)
    hits = sum(bool(a and b) for a, b in zip(flags, truth, strict=True))
    assert values["precision"] == pytest.approx(hits / flags.sum() if flags.any() else 0)
    assert values["recall"] == pytest.approx(hits / truth.sum())
    assert values["iou"] == pytest.approx(slow_iou(flags, truth))
    centre = [float(np.median(means[truth][:, axis].astype(float))) for axis in range(3)]
    assert values["location_error"] == pytest.approx(math.dist(centre, location))
    assert values["within_radius"] == (values["location_error_radii"] <= 1)


def test_no_location_is_a_miss_not_a_gap() -> None:
    flags = np.zeros(4, np.bool_)
    truth = np.array([1, 1, 0, 0], np.bool_)
    values = metrics.flags_3d(flags, truth, np.eye(4, 3, dtype=np.float32), None)
    assert values["within_radius"] == 0
    assert "location_error" not in values
    assert values["precision"] == values["recall"] == 0


@pytest.mark.parametrize(
    ("found", "absent", "correct"),
    [(True, False, 1), (False, True, 1), (True, True, 0), (False, False, 0)],
)
def test_refusal(found, absent, correct) -> None:
    assert metrics.refusal(found, absent) == {"found": float(found), "correct": float(correct)}
