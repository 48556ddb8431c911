"""LangSplat's mean, vote and threshold against loops and OpenCV's own filter."""

from __future__ import annotations

import cv2
import numpy as np
import protocol_cases as cases
import protocol_twins as twins
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gvr_core.protocols.relevancy import box_mean, majority, peaks, segment

SEEDS = st.integers(0, 2**32 - 1)
SIZES = st.sampled_from(cases.SIZES)


@settings(max_examples=150, deadline=None)
@given(SEEDS, SIZES)
def test_the_vote_equals_the_loop(seed: int, size: tuple[int, int]) -> None:
    picture = cases.mask(np.random.default_rng(seed), size)
    before = picture.copy()
    assert np.array_equal(majority(picture), twins.vote(picture))
    assert np.array_equal(picture, before)


def test_the_last_row_and_column_have_no_vote() -> None:
    """Windows end one early, so four columns stay four on the left, and three on the right."""
    left = np.zeros((20, 20), np.bool_)
    left[:, :4] = True
    # Column 3 sees 0 .. 6, of which 4 say yes.
    assert majority(left)[10].tolist() == [True] * 4 + [False] * 16
    # Column 16 sees 13 .. 18, of which 3 do; 17 sees 14 .. 18.
    assert majority(left[:, ::-1])[10].tolist() == [False] * 17 + [True] * 3
    assert np.array_equal(majority(left.T), majority(left).T)
    last = np.zeros((20, 20), np.bool_)
    last[:, -1] = last[-1] = True
    assert not majority(last).any()


def test_a_tied_vote_is_no() -> None:
    picture = np.array([[True, False, True], [False, True, True], [True] * 3])
    assert not majority(picture).any()  # 2 of the 4 pixels that vote
    picture[0, 1] = True
    assert majority(picture).all()


@settings(max_examples=60, deadline=None)
@given(SEEDS, SIZES)
def test_the_mean_equals_opencvs_filter_and_a_loop(seed: int, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    values = rng.random(size).astype(np.float32)
    mean = box_mean(values)
    assert mean == pytest.approx(twins.mean_30(values), abs=1e-12)
    padded = np.pad(values.astype(np.float64), ((15, 14), (15, 14)), mode="reflect")
    y, x = int(rng.integers(size[0])), int(rng.integers(size[1]))
    assert mean[y, x] == pytest.approx(padded[y : y + 30, x : x + 30].mean(), abs=1e-12)


def test_the_stretched_map_is_cut_at_seven_tenths() -> None:
    """0.4 of the upper half; the levels of wide plateaus stay clear of the mean's slopes."""
    level = np.zeros((200, 400), np.float32)
    level[:, 100:200], level[:, 200:300], level[:, 300:] = 0.69, 0.71, 1.0
    columns = segment(level[None], box_mean(level)[None])[100]
    assert not columns[:180].any()
    assert columns[220:].all()


def test_only_rounding_makes_a_tie() -> None:
    soft = np.zeros((100, 100), np.float32)
    soft[20:60, 20:60] = 1
    assert np.argwhere(peaks(box_mean(soft))).tolist() == [
        [y, x] for y in range(35, 46) for x in range(35, 46)
    ]
    soft[20, 20] = 1 - 1e-4  # only the mean at (35, 35) reaches it: less by 1.1e-7
    assert not peaks(box_mean(soft))[35, 35]
    assert peaks(box_mean(soft)).sum() == 11 * 11 - 1


def test_single_precision_differs_at_the_threshold_alone() -> None:
    """The evaluator's arithmetic; a few pixels of 722228 lie within its rounding."""
    level = cases.blobs(np.random.default_rng(8), cases.FULL, 40).astype(np.float32)
    mean = cv2.filter2D(level, -1, np.ones((30, 30)) / 900)
    blend = np.float32(0.5) * (mean + level)
    unit = blend - blend.min()
    unit /= unit.max() + np.float32(1e-9)
    single = majority(np.clip(unit * 2 - 1, 0, 1) > np.float32(0.4))
    double = segment(level[None], box_mean(level)[None])
    assert 1000 < double.sum() < 700_000
    assert (single != double).sum() <= 20
    assert np.array_equal(np.argwhere(mean == mean.max()), np.argwhere(peaks(box_mean(level))))
