from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.metrics import roc_auc_score

from reports.auroc import auroc
from reports.bootstrap import Estimate

Scenes = dict[str, tuple[list[float], list[float]]]


def pooled(scenes: list[tuple[list[float], list[float]]]) -> float:
    """scikit-learn's area over the queries of all scenes together."""
    present = [value for kinds in scenes for value in kinds[0]]
    absent = [value for kinds in scenes for value in kinds[1]]
    return float(roc_auc_score([1] * len(present) + [0] * len(absent), present + absent))


few = st.lists(st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0]), max_size=4)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(few, few), min_size=1, max_size=5))
def test_against_scikit_learn_with_ties_and_empty_kinds(
    content: list[tuple[list[float], list[float]]],
) -> None:
    area = auroc({str(i): kinds for i, kinds in enumerate(content)})
    if not any(p for p, _ in content) or not any(a for _, a in content):
        assert area is None
        return
    assert area is not None
    assert area.value == pytest.approx(pooled(content))


def test_the_interval_against_scikit_learn_on_resampled_scenes() -> None:
    rng = np.random.default_rng(5)
    scenes: Scenes = {
        str(i): (list(rng.normal(1.0, 1.0, 6)), list(rng.normal(0.1 * i, 1.0, 2))) for i in range(8)
    }
    area = auroc(scenes)
    assert area is not None
    chance = random.Random(1)
    slow = [pooled([scenes[chance.choice(list(scenes))] for _ in scenes]) for _ in range(1000)]
    exact = np.percentile(slow, [2.5, 97.5])
    assert [area.low, area.high] == pytest.approx(list(exact), abs=0.025)


def test_perfect_chance_and_reversed() -> None:
    assert auroc({"a": ([0.9, 0.8], [0.1])}) == Estimate(1.0, None, None, 1)
    assert auroc({"a": ([0.5, 0.5], [0.5])}) == Estimate(0.5, None, None, 1)
    assert auroc({"a": ([0.1], [0.9]), "b": ([0.2], [0.8])}) == Estimate(0.0, 0.0, 0.0, 2)


def test_one_kind_alone_has_no_area() -> None:
    assert auroc({}) is None
    assert auroc({"a": ([0.5], [])}) is None
    assert auroc({"a": ([], [0.5]), "b": ([], [])}) is None


def test_no_interval_where_a_resample_could_lack_a_kind() -> None:
    area = auroc({"a": ([0.9, 0.4], []), "b": ([0.6], [0.5]), "c": ([], [])})
    assert area == Estimate(pytest.approx(2 / 3), None, None, 2)
