"""Gaussian Grouping's protocol against its twin, and what it promises."""

from __future__ import annotations

import numpy as np
import protocol_cases as cases
import protocol_twins as twins
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gvr_core.protocols import protocol
from gvr_core.protocols.base import ViewPrediction, ViewTruth
from gvr_core.protocols.boundary import boundary, boundary_iou, boundary_width
from gvr_core.protocols.lerf_mask import gg, gg_compat

SEEDS = st.integers(0, 2**32 - 1)
SIZES = st.sampled_from((*cases.SIZES, (90, 120), (131, 77)))


@settings(max_examples=200, deadline=None)
@given(SEEDS, SIZES)
def test_both_equal_their_twins(seed: int, size: tuple[int, int]) -> None:
    pair = cases.pair(np.random.default_rng(seed), size)
    for values, expected in (
        (gg(*pair), twins.gg(*pair, strict=True)),
        (gg_compat(*pair), twins.gg(*pair, strict=False)),
    ):
        assert (values is None) == (expected is None)
        if values is not None:
            assert values == pytest.approx(expected, abs=1e-9)
            assert all(0 <= value <= 1 for value in values.values())


def test_a_full_picture_equals_its_twin() -> None:
    rng = np.random.default_rng(5)
    soft = cases.blobs(rng, cases.FULL, 60).astype(np.float32)
    truth = ViewTruth(np.roll(soft, 7, axis=1) > 0.45, ())
    values = gg(ViewPrediction(soft), truth)
    assert values == pytest.approx(twins.gg(ViewPrediction(soft), truth, strict=True), abs=1e-9)
    assert 0.1 < values["boundary_iou"] < values["iou"] - 0.1


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.sampled_from(((1, 1), (7, 5), (13, 29), (60, 70))))
def test_the_boundary_equals_its_definition(seed: int, size: tuple[int, int]) -> None:
    picture = cases.mask(np.random.default_rng(seed), size)
    assert np.array_equal(boundary(picture), twins.rim_by_distance(picture))
    assert np.array_equal(boundary(picture), twins.rim(picture))


def test_the_boundary_is_25_wide_at_988_by_731() -> None:
    assert boundary_width(731, 988) == boundary_width(988, 731) == 25
    full = np.ones((731, 988), np.bool_)
    assert (~boundary(full)).sum() == (731 - 50) * (988 - 50)
    assert not boundary(full)[25:-25, 25:-25].any()
    inner = np.zeros_like(full)
    inner[200:400, 300:600] = True
    assert boundary(inner).sum() == 200 * 300 - 150 * 250


def test_the_width_grows_with_the_picture() -> None:
    assert boundary_width(1, 1) == boundary_width(30, 40) == 1
    assert boundary_width(75, 100) == 2  # 2.5 goes to the even number
    assert boundary_width(105, 140) == 4  # 3.5 too
    assert boundary_width(1080, 1920) == 44


@settings(max_examples=80, deadline=None)
@given(SEEDS, SIZES)
def test_truth_and_prediction_may_change_places(seed: int, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    a, b = cases.mask(rng, size), cases.mask(rng, size)
    one = gg(ViewPrediction(a.astype(np.float32)), ViewTruth(b, ()))
    assert one == gg(ViewPrediction(b.astype(np.float32)), ViewTruth(a, ()))
    for turn in (np.flipud, np.fliplr, np.transpose):
        soft = np.ascontiguousarray(turn(a)).astype(np.float32)
        assert one == gg(ViewPrediction(soft), ViewTruth(np.ascontiguousarray(turn(b)), ()))


@settings(max_examples=80, deadline=None)
@given(SEEDS, SIZES)
def test_only_the_same_mask_is_perfect(seed: int, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    a, b = cases.mask(rng, size), cases.mask(rng, size)
    same = gg(ViewPrediction(a.astype(np.float32)), ViewTruth(a, ()))
    assert same == ({"iou": 1, "boundary_iou": 1} if a.any() else None)
    other = gg(ViewPrediction(a.astype(np.float32)), ViewTruth(b, ()))
    assert other is None or (other["iou"] == 1) == np.array_equal(a, b)


def test_the_boundary_tells_apart_what_the_mask_does_not() -> None:
    truth = np.zeros((300, 400), np.bool_)
    truth[50:250, 50:350] = True
    shrunk = np.zeros_like(truth)
    shrunk[56:244, 56:344] = True
    assert boundary_iou(shrunk, truth) < 0.5 < 0.9 < gg_iou(shrunk, truth)


def gg_iou(prediction: np.ndarray, truth: np.ndarray) -> float:
    values = gg(ViewPrediction(prediction.astype(np.float32)), ViewTruth(truth, ()))
    assert values is not None
    return values["iou"]


def test_empty_masks() -> None:
    nothing, something = np.zeros((30, 40), np.bool_), np.ones((30, 40), np.bool_)
    zero = {"iou": 0, "boundary_iou": 0}
    for score in (gg, gg_compat):
        assert score(ViewPrediction(nothing.astype(np.float32)), ViewTruth(something, ())) == zero
        assert score(ViewPrediction(something.astype(np.float32)), ViewTruth(nothing, ())) == zero
        assert score(ViewPrediction(nothing.astype(np.float32)), ViewTruth(nothing, ())) is None


@pytest.mark.parametrize("labelled", [False, True])
def test_what_is_missing_scores_zero_or_is_passed_over(labelled: bool) -> None:
    truth = ViewTruth(np.full((30, 40), labelled), ())
    missing = ViewPrediction(np.zeros((30, 40), np.float32), missing=True)
    assert gg(missing, truth) == {"iou": 0, "boundary_iou": 0}
    assert gg_compat(missing, truth) is None


def test_a_given_picture_is_cut_at_grey_128() -> None:
    values = np.arange(256).reshape(16, 16)
    truth = ViewTruth(values > 128, ())
    assert gg(ViewPrediction(cases.grey(values)), truth) == {"iou": 1, "boundary_iou": 1}


def test_how_they_are_averaged_and_shown() -> None:
    for name in ("lerf_mask.gg/1", "lerf_mask.gg_compat/1"):
        spec = protocol(name)
        assert spec.mean == "class"
        assert spec.headline == (("iou", "mIoU"), ("boundary_iou", "mBIoU"))
        assert not spec.needs_isolated
