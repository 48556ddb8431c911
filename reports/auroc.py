"""How well a method's confidence tells present objects from absent ones, at any threshold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from reports.bootstrap import Estimate, percentiles, resamples

Confidences = tuple[Sequence[float], Sequence[float]]
"""Of the present and of the absent queries of one scene."""


def auroc(confidences_by_scene: Mapping[str, Confidences]) -> Estimate | None:
    """Area under the ROC curve of confidence, over the queries of all scenes together.

    It is the probability that a present object gets more confidence than an absent one, ties
    counting half (the Mann-Whitney statistic): 1 is perfect, 0.5 is chance. In this form it is a
    quotient of sums over pairs of scenes, so that resampling scenes costs no new ranking.

    Args:
        confidences_by_scene: Scene -> confidence of its present and of its absent queries.

    Returns:
        The area, with a bootstrap interval over scenes (:mod:`reports.bootstrap`) where each of
        at least two scenes has both kinds, so that every resample has an area; None where one
        kind is missing altogether.
    """
    scenes = [kinds for kinds in confidences_by_scene.values() if len(kinds[0]) or len(kinds[1])]
    present = np.array([len(kinds[0]) for kinds in scenes], np.float64)
    absent = np.array([len(kinds[1]) for kinds in scenes], np.float64)
    if not present.sum() or not absent.sum():
        return None
    wins = np.array([[_wins(p, a) for _, a in scenes] for p, _ in scenes])
    n = len(scenes)
    value = float(wins.sum() / (present.sum() * absent.sum()))
    if n == 1 or not (present.all() and absent.all()):
        return Estimate(value, None, None, n)
    drawn = resamples(n)
    times = (drawn[:, :, None] == np.arange(n)).sum(axis=1).astype(np.float64)
    areas = ((times @ wins) * times).sum(axis=1) / ((times @ present) * (times @ absent))
    low, high = percentiles(areas)
    return Estimate(value, min(low, value), max(high, value), n)


def _wins(present: Sequence[float], absent: Sequence[float]) -> float:
    """Number of (present, absent) pairs with more confidence in the present; ties count half."""
    p: NDArray[np.float64] = np.asarray(present, np.float64)[:, None]
    a: NDArray[np.float64] = np.asarray(absent, np.float64)[None, :]
    return float((p > a).sum() + 0.5 * (p == a).sum())
