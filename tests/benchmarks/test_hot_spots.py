"""The profile by looking at the stack."""

from __future__ import annotations

import sys
import time

import numpy as np
import pytest
from hot_spots import innermost, profile

from gvr_core.cameras import look_at
from gvr_core.metrics import flags_3d
from gvr_core.ordered import in_order


def test_the_longest_function_comes_first_and_the_parts_are_of_the_whole() -> None:
    flags = np.zeros(200_000, np.bool_)
    flags[::2] = True
    means = np.zeros((200_000, 3), np.float32)

    def work() -> None:
        until = time.perf_counter() + 1.0
        while time.perf_counter() < until:
            flags_3d(flags, flags, means, None)
        look_at((1, 0, 0), (0, 0, 0), (0, 0, 1))

    seconds, spots = profile(work, every=0.002)
    assert seconds >= 1
    assert spots[0].place.startswith("gvr_core.metrics.")
    assert sum(spot.share for spot in spots) <= 1 + 1e-9
    assert sum(spot.share for spot in spots if ".metrics." in spot.place) > 0.5
    assert sorted(spots, key=lambda spot: -spot.seconds) == spots
    assert spots[0].seconds == pytest.approx(seconds * spots[0].share)


def test_work_that_is_handed_on_is_that_of_those_who_do_it() -> None:
    flags, means = np.ones(200_000, np.bool_), np.zeros((200_000, 3), np.float32)

    def score(_: int) -> None:
        until = time.perf_counter() + 0.5
        while time.perf_counter() < until:
            flags_3d(flags, flags, means, None)

    seconds, spots = profile(lambda: list(in_order(score, range(4), 2)), every=0.002)
    assert seconds >= 1
    assert sum(spot.share for spot in spots if ".metrics." in spot.place) > 0.8
    assert sum(spot.share for spot in spots) <= 1 + 1e-9


def test_work_outside_the_project_is_nobodys() -> None:
    _, spots = profile(lambda: time.sleep(0.1))
    assert spots == []
    assert innermost(sys._getframe()) is None
    assert innermost(None) is None


def test_an_error_of_the_work_ends_the_watching() -> None:
    def work() -> None:
        raise KeyError("of the work")

    with pytest.raises(KeyError, match="of the work"):
        profile(work)
