"""(B) of ``gvr-robust``: from relevancies to places, one for each instance, or to none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gvr_core.books import Books
from gvr_core.localize import Localization, Place, Retrieval, vote, voting_radius
from gvr_core.methods.robust_config import RobustLocate
from gvr_core.robust.candidates import (
    NEUTRAL,
    Candidate,
    best_of_each_view,
    gated_patches,
    place_candidate,
)
from gvr_core.robust.clusters import cluster_candidates, places_of
from gvr_core.scene import View

FloatArray = NDArray[np.float32]

CONFIDENCE_SHARE = 0.1
"""The part of all views whose word the confidence is made of."""


def find_places(
    books: Books,
    views: Sequence[View],
    scores: FloatArray,
    config: RobustLocate,
    refuse_below: float,
) -> Localization:
    """Where the object is: every instance of it, or nowhere.

    Args:
        books: The books of the scene.
        views: The knowledge views.
        scores: (M,) how much every patch is like the query.
        config: The switches.
        refuse_below: Least confidence to answer.

    Returns:
        The places, strongest first; none where the evidence is too thin, the confidence says how
        thin.
    """
    patches = books.semantics.patches
    chosen = _chosen_patches(books, scores, config)
    found = [
        place_candidate(j, float(scores[j]), patches, books.depths, views, config.median_depth)
        for j in chosen
    ]
    candidates = [candidate for candidate in found if candidate is not None]
    retrieval = _retrieval(candidates)
    if not candidates:
        best = float(scores.max(initial=0.0))
        return Localization(retrieval, np.empty(0, np.int64), (), 0.0, confidence=best)
    if config.stuff and _is_stuff(candidates, books, config.stuff_share):
        labels, reach = np.zeros(len(candidates), np.int64), 0.0
        labels, places = places_of(candidates, labels, 1.0, 1)
        is_stuff = True
    else:
        labels, places, reach = _things(candidates, retrieval, views, config)
        is_stuff = False
    sureness = _confidence(candidates, labels, len(views))
    n_views = len({c.view for c, own in zip(candidates, labels, strict=True) if own == 0})
    if config.refusal and (sureness < refuse_below or n_views < config.min_views):
        places, labels = (), np.full(len(candidates), -1, np.int64)
    return Localization(retrieval, labels, places, reach, sureness, is_stuff)


def _chosen_patches(books: Books, scores: FloatArray, config: RobustLocate) -> list[int]:
    patches, coarsest = books.semantics.patches, not config.multi_level_masks
    if not config.several_patches:
        return best_of_each_view(scores, patches, coarsest)
    best = float(scores.max(initial=0.0))
    gate = max(config.gate, NEUTRAL + config.gate_share * (best - NEUTRAL))
    chosen = gated_patches(scores, patches, gate, coarsest)
    if not chosen and not config.refusal:
        return best_of_each_view(scores, patches, coarsest)
    return chosen


def _things(
    candidates: Sequence[Candidate],
    retrieval: Retrieval,
    views: Sequence[View],
    config: RobustLocate,
) -> tuple[NDArray[np.int64], tuple[Place, ...], float]:
    """Places of things: density clusters, or the paper's vote."""
    most = config.max_instances if config.all_instances else 1
    if config.density_clusters:
        labels, reach = cluster_candidates(candidates, config.cluster_radii, config.min_share)
        return *places_of(candidates, labels, config.instance_share, most), reach
    reach = voting_radius(retrieval, views, config.vote_radius)
    supporters = vote(retrieval.points, reach)
    labels = np.where(supporters, 0, -1).astype(np.int64)
    members = [c for c, own in zip(candidates, supporters, strict=True) if own]
    place = Place(
        retrieval.points[supporters].mean(axis=0),
        float(np.median([c.radius for c in members])),
        sum(c.evidence for c in members),
    )
    return labels, (place,), reach


def _is_stuff(candidates: Sequence[Candidate], books: Books, share: float) -> bool:
    """Whether what the candidates cover together is most often a large part of the picture."""
    patches = books.semantics.patches
    covered: dict[int, int] = {}
    for candidate in candidates:
        covered[candidate.view] = covered.get(candidate.view, 0) + int(
            patches.areas[candidate.patch]
        )
    parts = [area / float(np.prod(patches.sizes[view])) for view, area in covered.items()]
    return float(np.median(parts)) > share


def _confidence(candidates: Sequence[Candidate], labels: NDArray[np.int64], n: int) -> float:
    """Mean relevancy of the views that speak for the first place, the best tenth of all views.

    An object may be in sight of few cameras only, so most views' silence says nothing; a single
    view's word is not enough, so at least two are asked for.
    """
    best: dict[int, float] = {}
    for candidate, own in zip(candidates, labels, strict=True):
        if own == 0:
            best[candidate.view] = max(best.get(candidate.view, 0.0), candidate.relevancy)
    asked = max(2, round(CONFIDENCE_SHARE * n))
    return sum(sorted(best.values(), reverse=True)[:asked]) / asked


def _retrieval(candidates: Sequence[Candidate]) -> Retrieval:
    return Retrieval(
        np.array([c.view for c in candidates], np.int64),
        np.array([c.patch for c in candidates], np.int64),
        np.array([c.relevancy for c in candidates], np.float32),
        np.array([c.pixel for c in candidates], np.float64).reshape(-1, 2),
        np.array([c.point for c in candidates], np.float64).reshape(-1, 3),
    )
