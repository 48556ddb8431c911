"""Medians, spreads, fits and tables of the benchmarks."""

from __future__ import annotations

import pytest
from measuring import Bar, Spread, markdown, spread_of, straight_fit


def test_a_spread_is_median_least_and_most() -> None:
    spread = Spread.of([0.003, 0.001, 0.002, 0.010])
    assert (spread.median, spread.least, spread.most, spread.repeats) == (0.0025, 0.001, 0.010, 4)
    assert spread.shown(1e-3) == "2.5 (1.0-10.0)"
    assert spread.scaled(1000).shown(digits=0) == "2 (1-10)"
    assert Spread.of([7.0]).shown() == "7.0 (7.0-7.0)"
    with pytest.raises(ValueError, match="no value"):
        Spread.of([])


def test_warm_calls_do_not_count() -> None:
    ticks = iter(range(100))
    called: list[int] = []
    spread = spread_of(lambda: called.append(next(ticks)), 3, warm=2, clock=lambda: next(ticks))
    assert len(called) == 5
    assert spread == Spread(2, 2, 2, 3)  # one tick of the work, one of the clock


def test_a_line_through_points_on_a_line() -> None:
    line = straight_fit([10, 100, 1000], [0.5 + 0.002 * x for x in (10, 100, 1000)])
    assert line.constant == pytest.approx(0.5)
    assert line.slope == pytest.approx(0.002)
    assert line.explained == pytest.approx(1)


def test_small_sizes_count_in_a_fit_as_much_as_large_ones() -> None:
    # A tenth too long at the largest size would, in absolute terms, drown the smallest.
    line = straight_fit([1, 10, 100, 1000], [0.01, 0.1, 1.0, 11.0])
    assert abs(line.constant + line.slope - 0.01) < 0.002
    assert 0.9 < line.explained < 1


def test_what_is_no_line_is_refused() -> None:
    for x, y in (([1], [1.0]), ([1, 1], [1.0, 2.0]), ([1, 2], [1.0, 0.0]), ([1, 2], [1.0])):
        with pytest.raises(ValueError, match="no line"):
            straight_fit(x, y)


def test_bars_are_met_or_missed() -> None:
    assert Bar("fast", 25.0, 20.0, "times", at_least=True).met
    assert not Bar("fast", 19.9, 20.0, "times", at_least=True).met
    assert Bar("short", 7.0, 7.0, "times").met
    missed = Bar("short", 7.123, 7.0, "times")
    assert missed.cells() == ("short", "7.12 times", "<= 7 times", "**missed**")


def test_a_table_is_markdown() -> None:
    assert markdown(("a", "b"), [("1", "2")]) == "| a | b |\n| :--- | ---: |\n| 1 | 2 |"
    with pytest.raises(ValueError, match="3 cells under a head of 2"):
        markdown(("a", "b"), [("1", "2", "3")])
