"""Means over scenes with bootstrap intervals, and the same for differences.

Scenes are what is drawn anew, with all their queries: the queries of one scene share its
geometry, its views and its objects, so they are no independent draws, and the question is what
another set of such scenes would have given. The interval is the percentile one (Efron and
Tibshirani 1993, "An Introduction to the Bootstrap", chapter 13). With few scenes it is too
narrow; for scene means from a normal distribution, in 2,000 simulated benchmarks each
(`python benchmarks/interval_coverage.py`):

====== ====================================
scenes intervals that held the true mean
====== ====================================
4      0.79
10     0.90
30     0.92
====== ====================================
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

N_RESAMPLES = 10_000
LEVEL = 95.0
"""Per cent of the resamples that an interval holds."""
SEED = 20_260_101

_Key = TypeVar("_Key", bound=Hashable)


@dataclass(frozen=True)
class Estimate:
    """A number that scenes gave, and the range within which other scenes might have put it."""

    value: float
    low: float | None
    """Lower end of the interval; None where there is none, as with a single scene."""
    high: float | None
    n_scenes: int


@dataclass(frozen=True)
class Difference:
    """How much larger one line's numbers are than another's on the same pairs."""

    estimate: Estimate
    n_pairs: int
    """Pairs that both have."""
    n_missing: int
    """Pairs that only one of them has, and that were left out."""


def interval(values_by_scene: Mapping[str, Sequence[float]]) -> Estimate | None:
    """The unweighted mean over scenes of each scene's mean, with its bootstrap interval.

    Args:
        values_by_scene: Scene -> values; scenes without values do not count.

    Returns:
        The estimate, without interval for a single scene; None where there are no values.
    """
    means = [math.fsum(v) / len(v) for v in values_by_scene.values() if len(v)]
    if not means:
        return None
    value = math.fsum(means) / len(means)
    if len(means) == 1:
        return Estimate(value, None, None, 1)
    low, high = percentiles(np.array(means)[resamples(len(means))].mean(axis=1))
    # Summing in another order may move a mean of equal numbers by a last bit.
    return Estimate(value, min(low, value), max(high, value), len(means))


def paired(
    values: Mapping[str, Mapping[_Key, float]], reference: Mapping[str, Mapping[_Key, float]]
) -> Difference | None:
    """The mean difference, over the pairs that both have, with its bootstrap interval.

    Args:
        values: Scene -> pair (a query, or a query in a view) -> value.
        reference: The same of what it is compared with; it is subtracted.

    Returns:
        The difference; None where no pair is in both.
    """
    differences: dict[str, list[float]] = {}
    n_pairs = n_missing = 0
    for scene in dict.fromkeys([*values, *reference]):
        mine, theirs = values.get(scene, {}), reference.get(scene, {})
        common = [key for key in mine if key in theirs]
        differences[scene] = [mine[key] - theirs[key] for key in common]
        n_pairs += len(common)
        n_missing += len(mine.keys() ^ theirs.keys())
    estimate = interval(differences)
    return None if estimate is None else Difference(estimate, n_pairs, n_missing)


@lru_cache(maxsize=64)
def resamples(n_scenes: int) -> NDArray[np.intp]:
    """(N_RESAMPLES, n_scenes) which scenes each resample draws; the same in every call."""
    drawn = np.random.default_rng(SEED).integers(0, n_scenes, (N_RESAMPLES, n_scenes))
    drawn.flags.writeable = False
    return drawn


def percentiles(statistics: NDArray[np.float64]) -> tuple[float, float]:
    """The ends of the central interval of resampled statistics (n,)."""
    tail = (100.0 - LEVEL) / 2
    low, high = np.percentile(statistics, [tail, 100.0 - tail])
    return float(low), float(high)
