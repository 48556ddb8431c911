"""(B) of ``gvr-robust``: from relevancies to places, one for each instance, or to none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gvr_core.books import Books
from gvr_core.localize import (
    Localization,
    Place,
    Retrieval,
    best_patches,
    vote,
    voting_radius,
)
from gvr_core.robust.candidates import (
    NEUTRAL,
    Candidate,
    best_of_each_view,
    gated_patches,
    place_candidate,
)
from gvr_core.robust.clusters import cluster_candidates, places_of
from gvr_core.robust.config import RobustLocate
from gvr_core.scene import View
from gvr_core.stopwatch import step

FloatArray = NDArray[np.float32]

CONFIDENCE_SHARE = 0.1
"""The part of the views that put something forward whose word the confidence is made of."""


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
    with step("best patches"):
        chosen = _chosen_patches(books, scores, config)
    with step("back-projection"):
        found = [
            place_candidate(j, float(scores[j]), patches, books.depths, views, config.median_depth)
            for j in chosen
        ]
    candidates = [candidate for candidate in found if candidate is not None]
    retrieval = _retrieval(candidates)
    if not candidates:
        none = np.empty(0, np.int64)
        return Localization(retrieval, none, (), 0.0, _sureness(_best_of_views(books, scores)))
    if config.stuff and _is_stuff(candidates, books, config.stuff_share):
        reach, is_stuff = 0.0, True
        with step("voting"):
            labels, places = places_of(candidates, np.zeros(len(candidates), np.int64), 1.0, 1)
    else:
        is_stuff = False
        with step("voting"):
            labels, places, reach = _things(candidates, retrieval, views, config)
    supporters = [c for c, own in zip(candidates, labels, strict=True) if own == 0]
    best: dict[int, float] = {}
    for candidate in supporters:
        best[candidate.view] = max(best.get(candidate.view, 0.0), candidate.relevancy)
    sureness = _sureness(list(best.values()))
    asked = min(config.min_views, len(views))
    if config.refusal and (sureness < refuse_below or len(best) < asked):
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
        if not config.refusal and labels.max(initial=-1) < 0:
            # no two agree, and an answer is wanted all the same
            labels[int(np.argmax([c.relevancy for c in candidates]))] = 0
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
    """Whether it is an area: most often a large part of the picture, and cut off by its border.

    A thing that a camera is close to may be as large, but has its outline in the picture.
    """
    patches = books.semantics.patches
    largest: dict[int, int] = {}
    for candidate in candidates:
        known = largest.get(candidate.view)
        if known is None or patches.areas[candidate.patch] > patches.areas[known]:
            largest[candidate.view] = candidate.patch
    parts, cut = [], []
    for view, patch in largest.items():
        height, width = patches.sizes[view]
        x0, y0, x1, y1 = patches.boxes[patch]
        parts.append(float(patches.areas[patch]) / float(height * width))
        cut.append(x0 <= 0 or y0 <= 0 or x1 >= width or y1 >= height)
    return float(np.median(parts)) > share and float(np.mean(cut)) > 0.5


def _sureness(best: Sequence[float]) -> float:
    """Mean relevancy of the views that say most: a tenth of those that say anything, at least two.

    An object may be in sight of few cameras only, so the silence of the others means nothing;
    and a single view's word counts as half.

    Args:
        best: The best relevancy of each view that puts something forward.
    """
    asked = max(2, round(CONFIDENCE_SHARE * len(best)))
    return float(sum(sorted(best, reverse=True)[:asked]) / asked)


def _best_of_views(books: Books, scores: FloatArray) -> list[float]:
    """The best relevancy of each view, whatever passes the gate."""
    _, best = best_patches(scores, books.semantics.patches.view_ptr)
    return [float(score) for score in scores[best]]


def _retrieval(candidates: Sequence[Candidate]) -> Retrieval:
    return Retrieval(
        np.array([c.view for c in candidates], np.int64),
        np.array([c.patch for c in candidates], np.int64),
        np.array([c.relevancy for c in candidates], np.float32),
        np.array([c.pixel for c in candidates], np.float64).reshape(-1, 2),
        np.array([c.point for c in candidates], np.float64).reshape(-1, 3),
    )
