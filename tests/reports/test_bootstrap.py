"""The intervals, against slow and obvious twins and what is known exactly."""

from __future__ import annotations

import itertools
import random
from statistics import fmean

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reports.bootstrap import N_RESAMPLES, Estimate, interval, paired, resamples

VALUES = {"a": [0.1, 0.3], "b": [0.9], "c": [0.4, 0.4, 0.7], "d": [0.0], "e": [0.55]}


def slow_interval(values: dict[str, list[float]], seed: int) -> tuple[float, float]:
    """Draw scenes, one after the other, and average them; again and again."""
    chance = random.Random(seed)
    scenes = list(values)
    means = []
    for _ in range(N_RESAMPLES):
        drawn = [chance.choice(scenes) for _ in scenes]
        means.append(fmean(fmean(values[scene]) for scene in drawn))
    means.sort()
    return means[round(0.025 * N_RESAMPLES)], means[round(0.975 * N_RESAMPLES)]


def test_the_value_is_the_mean_of_scene_means() -> None:
    estimate = interval(VALUES)
    assert estimate is not None
    assert estimate.value == pytest.approx((0.2 + 0.9 + 0.5 + 0.0 + 0.55) / 5)
    assert estimate.n_scenes == 5


def test_the_interval_against_a_slow_twin() -> None:
    values = {str(i): [(7 * i % 12) / 11, i / 30] for i in range(12)}
    estimate = interval(values)
    assert estimate is not None
    # The ends of two draws of 10,000 differ by about a hundredth of the interval's width.
    assert (estimate.low, estimate.high) == pytest.approx(slow_interval(values, 3), abs=0.005)


@pytest.mark.parametrize("n", [3, 5])
def test_the_interval_against_all_resamples_there_are(n: int) -> None:
    means = [0.0, 1.0, 0.3, 0.45, 0.8][:n]
    every = [fmean(drawn) for drawn in itertools.product(means, repeat=n)]
    estimate = interval({str(i): [mean] for i, mean in enumerate(means)})
    assert estimate is not None
    exact = np.percentile(every, [2.5, 97.5], method="inverted_cdf")
    assert [estimate.low, estimate.high] == pytest.approx(list(exact), abs=0.02)


def test_one_scene_has_no_interval_however_many_queries() -> None:
    assert interval({"a": [0.0, 1.0, 0.5]}) == Estimate(0.5, None, None, 1)
    assert interval({"a": [0.25], "b": []}) == Estimate(0.25, None, None, 1)


def test_nothing_is_nothing() -> None:
    assert interval({}) is None
    assert interval({"a": []}) is None
    assert paired({"a": {"q": 1.0}}, {"b": {"q": 1.0}}) is None


def test_equal_scenes_give_an_interval_without_width() -> None:
    estimate = interval({scene: [0.1, 0.1, 0.1] for scene in "abcdefg"})
    assert estimate is not None
    assert estimate.low == pytest.approx(0.1, abs=1e-12)
    assert estimate.high == pytest.approx(0.1, abs=1e-12)
    assert estimate.low <= estimate.value <= estimate.high


def test_the_same_again_gives_the_same() -> None:
    first = interval(VALUES)
    resamples.cache_clear()
    assert interval(VALUES) == first


def test_more_scenes_make_it_narrower() -> None:
    widths = []
    for n in (4, 16, 64):
        estimate = interval({str(i): [float(i % 4)] for i in range(n)})
        assert estimate is not None and estimate.low is not None and estimate.high is not None
        widths.append(estimate.high - estimate.low)
    # The error of a mean goes with one over the root of the number.
    assert widths[0] / widths[1] == pytest.approx(2, rel=0.15)
    assert widths[1] / widths[2] == pytest.approx(2, rel=0.15)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.lists(st.floats(-1, 1), min_size=1, max_size=4), min_size=2, max_size=8))
def test_the_interval_holds_the_value_and_lies_between_the_scenes(
    values: list[list[float]],
) -> None:
    estimate = interval({str(i): scene for i, scene in enumerate(values)})
    assert estimate is not None and estimate.low is not None and estimate.high is not None
    means = [fmean(scene) for scene in values]
    assert min(means) - 1e-9 <= estimate.low <= estimate.value
    assert estimate.value <= estimate.high <= max(means) + 1e-9


def test_a_difference_is_taken_pair_by_pair() -> None:
    ours = {"a": {"q": 0.5, "r": 0.7}, "b": {"q": 0.2}}
    theirs = {"a": {"q": 0.4, "r": 0.4}, "b": {"q": 0.6}}
    difference = paired(ours, theirs)
    assert difference is not None
    assert difference.estimate.value == pytest.approx(((0.1 + 0.3) / 2 - 0.4) / 2)
    assert (difference.n_pairs, difference.n_missing) == (3, 0)


def test_a_constant_gain_is_certain_where_unpaired_numbers_would_hide_it() -> None:
    theirs = {scene: {"q": i / 10, "r": i / 20} for i, scene in enumerate("abcdefgh")}
    ours = {s: {q: value + 0.02 for q, value in pairs.items()} for s, pairs in theirs.items()}
    difference, alone = paired(ours, theirs), interval({s: [p["q"]] for s, p in ours.items()})
    assert difference is not None and alone is not None
    low, high = difference.estimate.low, difference.estimate.high
    assert (low, high) == pytest.approx((0.02, 0.02))
    assert alone.low is not None and alone.high is not None
    assert alone.high - alone.low > 0.2


def test_pairs_that_one_lacks_are_left_out_and_counted() -> None:
    ours = {"a": {"q": 0.5, "r": 0.9}, "b": {"q": 0.3}, "c": {"q": 1.0}}
    theirs = {"a": {"q": 0.4}, "b": {"q": 0.3, "s": 0.1}, "d": {"q": 0.0, "r": 0.0}}
    difference = paired(ours, theirs)
    assert difference is not None
    assert difference.estimate.value == pytest.approx((0.1 + 0.0) / 2)
    assert difference.estimate.n_scenes == 2
    # a/r, b/s, c/q, d/q and d/r.
    assert (difference.n_pairs, difference.n_missing) == (2, 5)


def test_the_difference_is_antisymmetric() -> None:
    ours = {s: dict(enumerate(values)) for s, values in VALUES.items()}
    theirs = {s: {i: 1 - v**2 for i, v in enumerate(values)} for s, values in VALUES.items()}
    there, back = paired(ours, theirs), paired(theirs, ours)
    assert there is not None and back is not None
    assert there.estimate.value == pytest.approx(-back.estimate.value)
    assert there.estimate.low is not None and back.estimate.high is not None
    assert there.estimate.low == pytest.approx(-back.estimate.high)
