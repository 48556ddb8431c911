"""LangSplat's and OpenGaussian's protocols against their twins, and what they promise."""

from __future__ import annotations

import numpy as np
import protocol_cases as cases
import protocol_twins as twins
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gvr_core.protocols import protocol
from gvr_core.protocols.base import ViewPrediction, ViewTruth
from gvr_core.protocols.lerf_ovs import langsplat_2d, opengaussian_3d
from gvr_core.protocols.relevancy import box_mean, peaks

SEEDS = st.integers(0, 2**32 - 1)
SIZES = st.sampled_from(cases.SIZES)
CLOSE = 1e-9


def truth_of(mask: np.ndarray, *boxes: tuple[float, float, float, float]) -> ViewTruth:
    return ViewTruth(mask, boxes)


def square(size: tuple[int, int], top: int, left: int, side: int) -> np.ndarray:
    picture = np.zeros(size, np.bool_)
    picture[top : top + side, left : left + side] = True
    return picture


def compare(prediction: ViewPrediction, truth: ViewTruth) -> None:
    values, expected = langsplat_2d(prediction, truth), twins.langsplat_2d(prediction, truth)
    assert (values is None) == (expected is None)
    if values is not None:
        assert values == pytest.approx(expected, abs=CLOSE)
        assert all(0 <= value <= 1 for value in values.values())


@settings(max_examples=150, deadline=None)
@given(SEEDS, SIZES, st.integers(0, 3))
def test_langsplat_equals_its_twin(seed: int, size: tuple[int, int], levels: int) -> None:
    compare(*cases.pair(np.random.default_rng(seed), size, levels))


@settings(max_examples=150, deadline=None)
@given(SEEDS, SIZES)
def test_opengaussian_equals_its_twin(seed: int, size: tuple[int, int]) -> None:
    pair = cases.pair(np.random.default_rng(seed), size)
    assert opengaussian_3d(*pair) == pytest.approx(twins.opengaussian_3d(*pair), abs=CLOSE)


def test_a_full_picture_equals_its_twin() -> None:
    rng = np.random.default_rng(3)
    level = cases.blobs(rng, cases.FULL, 40).astype(np.float32)
    truth = ViewTruth(level > 0.6, cases.boxes(rng, cases.FULL))
    prediction = ViewPrediction(level, relevancy=level[None])
    compare(prediction, truth)
    assert 0.3 < (langsplat_2d(prediction, truth) or {})["iou"] < 1
    compare(ViewPrediction(level, pixel=(400.2, 300.7)), truth)


@pytest.mark.parametrize(
    ("offset", "hit"), [(-15, False), (-14, True), (0, True), (15, True), (16, False)]
)
@pytest.mark.parametrize("axis", [0, 1])
def test_the_even_window_reaches_further_up_and_left(offset: int, hit: bool, axis: int) -> None:
    """x sees x - 15 .. x + 14, so a lone pixel at 50 is seen from 36 .. 65, all of them maxima."""
    soft = np.zeros((100, 100), np.float32)
    soft[50, 50] = 1
    assert np.argwhere(peaks(box_mean(soft))).min() == 36
    assert np.argwhere(peaks(box_mean(soft))).max() == 65
    at = [50.0, 50.0]
    at[axis] += offset
    values = langsplat_2d(ViewPrediction(soft), truth_of(soft > 0, (*at, *at)))
    assert values is not None
    assert values["acc"] == float(hit)


def test_one_maximum_in_one_box_is_enough() -> None:
    soft = np.zeros((200, 200), np.float32)
    soft[20:60, 20:60] = soft[140:180, 140:180] = 1  # two equal peaks, at 35 .. 45 and 155 .. 165
    truth = square(soft.shape, 20, 20, 40)
    far, first, second = (90, 90, 99, 99), (38, 38, 40, 40), (160, 160, 161, 161)
    for boxes, hit in (
        ((far,), 0),
        ((first,), 1),
        ((second,), 1),
        ((far, second), 1),
        ((first, second), 1),
        ((), 0),
    ):
        values = langsplat_2d(ViewPrediction(soft), ViewTruth(truth, boxes))
        assert values is not None
        assert values["acc"] == hit, boxes


def test_boxes_are_inclusive_and_their_corners_come_in_any_order() -> None:
    soft = np.zeros((100, 100), np.float32)
    soft[50, 50] = 1  # maxima at 36 .. 65
    for box, hit in (
        ((0, 0, 36, 36), 1),
        ((36, 36, 0, 0), 1),
        ((0, 36, 36, 0), 1),
        ((0, 0, 35.9, 99), 0),
        ((65, 65, 99, 99), 1),
        ((65.1, 0, 99, 99), 0),
    ):
        values = langsplat_2d(ViewPrediction(soft, pixel=(36.9, 36.9)), truth_of(soft > 0, box))
        assert values is not None
        assert values["acc"] == hit, box
    inside = langsplat_2d(
        ViewPrediction(soft, pixel=(36.9, 36.9)), truth_of(soft > 0, (0, 0, 36, 36))
    )
    outside = langsplat_2d(
        ViewPrediction(soft, pixel=(37.0, 36.9)), truth_of(soft > 0, (0, 0, 36, 36))
    )
    assert inside is not None
    assert outside is not None
    assert (inside["acc_center"], outside["acc_center"]) == (1, 0)


def test_mask_and_place_choose_their_levels_apart() -> None:
    """The mask by the peak of the blend, the place by that of the mean alone."""
    sharp = np.zeros((90, 90), np.float32)
    sharp[10:20, 10:20] = 1  # mean 1/9, blend 0.56
    wide = np.zeros((90, 90), np.float32)
    wide[40:80, 40:80] = 0.5  # mean and blend 0.5
    for maps in ((sharp, wide), (wide, sharp)):
        values = langsplat_2d(
            ViewPrediction(sharp, relevancy=np.stack(maps)),
            truth_of(square((90, 90), 10, 10, 10), (55, 55, 65, 65)),
        )
        assert values is not None
        assert values["iou"] > 0.5
        assert values["acc"] == 1


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_levels_in_another_order_and_larger_values_give_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    maps = np.stack([cases.blobs(rng, (40, 50)) * rng.uniform(0.3, 1) for _ in range(3)])
    truth = ViewTruth(cases.mask(rng, (40, 50)), cases.boxes(rng, (40, 50)))
    soft = maps.max(axis=0).astype(np.float32)
    first = langsplat_2d(ViewPrediction(soft, relevancy=maps.astype(np.float32)), truth)
    for other in (maps[::-1], maps[[1, 2, 0]], maps * 0.5):
        assert langsplat_2d(ViewPrediction(soft, relevancy=other.astype(np.float32)), truth) == (
            pytest.approx(first, abs=CLOSE)
        )


@settings(max_examples=40, deadline=None)
@given(SEEDS, st.integers(0, 2))
def test_rows_for_columns_give_the_same(seed: int, levels: int) -> None:
    prediction, truth = cases.pair(np.random.default_rng(seed), (31, 44), levels)
    maps = prediction.relevancy
    turned = ViewPrediction(
        prediction.soft.T.copy(),
        relevancy=None if maps is None else maps.transpose(0, 2, 1).copy(),
        pixel=None if prediction.pixel is None else prediction.pixel[::-1],
    )
    boxes = tuple((b, a, d, c) for a, b, c, d in truth.boxes)
    values = langsplat_2d(prediction, truth)
    again = langsplat_2d(turned, ViewTruth(truth.mask.T.copy(), boxes))
    assert (values is None) == (again is None)
    assert values is None or again == pytest.approx(values, abs=CLOSE)


def test_a_flat_relevancy_has_no_mask() -> None:
    flat = np.full((40, 40), 0.3, np.float32)
    truth = truth_of(square((40, 40), 5, 5, 9), (5, 5, 13, 13))
    values = langsplat_2d(ViewPrediction(flat, relevancy=flat[None]), truth)
    assert values is not None
    assert values["iou"] == 0
    silent = np.zeros_like(flat)
    values = langsplat_2d(ViewPrediction(silent, relevancy=silent[None]), truth)
    assert values is not None
    assert values["iou"] == values["acc"] == 0


def test_nothing_predicted_scores_zero() -> None:
    soft = np.zeros((40, 40), np.float32)
    truth = truth_of(square((40, 40), 5, 5, 20), (0, 0, 39, 39))
    for missing in (False, True):
        values = langsplat_2d(ViewPrediction(soft, missing=missing), truth)
        assert values is not None
        assert values.pop("pixel_acc") == pytest.approx(0.75)
        assert set(values.values()) == {0.0}
        said = opengaussian_3d(ViewPrediction(soft, isolated=soft, missing=missing), truth)
        assert said == {"iou": 0, "acc_at_0.25": 0, "acc_at_0.5": 0}


def test_nothing_labelled() -> None:
    empty = truth_of(np.zeros((40, 40), np.bool_))
    soft = square((40, 40), 5, 5, 20).astype(np.float32)
    values = langsplat_2d(ViewPrediction(soft, pixel=(9, 9)), empty)
    assert values is not None
    assert values.pop("pixel_acc") == pytest.approx(0.75)
    assert set(values.values()) == {0.0}
    assert langsplat_2d(ViewPrediction(np.zeros_like(soft)), empty) is None
    nothing = ViewPrediction(np.zeros_like(soft), isolated=np.zeros_like(soft))
    assert opengaussian_3d(nothing, empty)["iou"] == 0


def test_a_perfect_prediction() -> None:
    mask = square((90, 80), 20, 10, 50)
    soft = mask.astype(np.float32)
    truth = truth_of(mask, (10, 20, 59, 69))
    values = langsplat_2d(ViewPrediction(soft, pixel=(30, 40)), truth)
    assert values is not None
    assert set(values.values()) == {1.0}
    assert set(opengaussian_3d(ViewPrediction(soft, isolated=soft), truth).values()) == {1.0}


def test_half_is_not_above_half() -> None:
    mask = square((8, 8), 0, 0, 8)
    half = np.full((8, 8), 0.5, np.float32)
    for soft, overlap in ((half, 0.0), (np.nextafter(half, np.float32(1)), 1.0)):
        values = langsplat_2d(ViewPrediction(soft), truth_of(mask, (0, 0, 7, 7)))
        assert values is not None
        assert values["iou"] == overlap


@pytest.mark.parametrize(("share", "quarter", "half"), [(4, 0, 0), (5, 1, 0), (8, 1, 0), (9, 1, 1)])
def test_overlaps_count_strictly_above(share: int, quarter: int, half: int) -> None:
    truth = truth_of(np.ones((4, 4), np.bool_), (0, 0, 3, 3))
    soft = np.zeros(16, np.float32)
    soft[:share] = 1
    soft = soft.reshape(4, 4)
    for values in (
        langsplat_2d(ViewPrediction(soft), truth),
        opengaussian_3d(ViewPrediction(soft, isolated=soft), truth),
    ):
        assert values is not None
        assert values["iou"] == share / 16
        assert (values["acc_at_0.25"], values["acc_at_0.5"]) == (quarter, half)


def test_opengaussian_draws_the_target_alone() -> None:
    """What hides the target from the camera does not lower the score, unlike in 2D."""
    mask = square((40, 40), 5, 5, 20)
    hidden = ViewPrediction(np.zeros((40, 40), np.float32), isolated=mask.astype(np.float32))
    assert opengaussian_3d(hidden, truth_of(mask))["iou"] == 1
    faint = ViewPrediction(mask.astype(np.float32), isolated=mask.astype(np.float32) * 0.7)
    assert opengaussian_3d(faint, truth_of(mask))["iou"] == 0
    strong = ViewPrediction(faint.soft, isolated=mask.astype(np.float32) * np.float32(0.701))
    assert opengaussian_3d(strong, truth_of(mask))["iou"] == 1


def test_a_given_silhouette_is_cut_at_grey_10() -> None:
    values = np.arange(256).reshape(16, 16)
    truth = truth_of(values > 10)
    assert opengaussian_3d(ViewPrediction(cases.grey(values)), truth)["iou"] == 1


def test_relevancy_chooses_no_gaussians() -> None:
    level = np.ones((8, 8), np.float32)
    truth = truth_of(np.ones((8, 8), np.bool_))
    assert opengaussian_3d(ViewPrediction(level, relevancy=level[None]), truth) == {}


def test_how_they_are_averaged_and_shown() -> None:
    seen, chosen = protocol("lerf_ovs.langsplat_2d/1"), protocol("lerf_ovs.opengaussian_3d/1")
    assert (seen.mean, chosen.mean) == ("flat", "flat")
    assert seen.headline == (("acc", "Acc"), ("iou", "mIoU"))
    assert [metric for metric, _ in chosen.headline] == ["iou", "acc_at_0.25", "acc_at_0.5"]
    assert (seen.needs_isolated, chosen.needs_isolated) == (False, True)
