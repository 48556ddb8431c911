"""(C) of ``gvr-robust``: from one place to the Gaussians of the object there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gvr_core.localize import Localization
from gvr_core.ordered import in_order
from gvr_core.robust.ballot import Ballot
from gvr_core.robust.cleanup import follow_neighbours
from gvr_core.robust.virtual_views import birds_eye, look_around
from gvr_core.robust.workplace import Weights, Workplace
from gvr_core.segment import VirtualView
from gvr_core.stopwatch import step
from gvr_core.threads import available_threads

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float32]
Float64Array = NDArray[np.float64]

LEAST_TRUST = 0.05
"""A detection counts at least so much, whatever its score."""
LEAST_VOTING_VIEWS = 2
"""With fewer voting views the coarse set is the answer."""


@dataclass(frozen=True, eq=False)
class Segmented:
    """The object at one place, and the evidence."""

    flags: BoolArray
    """(N,)."""
    scores: FloatArray
    """(N,) in [0, 1]: share of the votes; at least 0.5 where the flag is set, else less."""
    bev: VirtualView | None = None
    ring: Sequence[VirtualView] = ()


def segment_area(work: Workplace, localization: Localization) -> Segmented:
    """An area (lawn, wall): no view from above or around shows it whole, so views are lifted."""
    ballot = Ballot(len(work.scene.gaussians))
    _ask_views(work, localization, 0, ballot)
    return _count(work, ballot, ballot.share >= work.config.keep_at)


def segment_thing(work: Workplace, localization: Localization, index: int, text: str) -> Segmented:
    """A thing at a place: bird's-eye view, retrieved views and ring, each with its vote.

    Args:
        work: What to work with.
        localization: All places, and the patches behind them.
        index: Which place.
        text: The query, for the ring.
    """
    config, place = work.config, localization.places[index]
    ballot = Ballot(len(work.scene.gaussians))
    above = birds_eye(work, place)
    coarse = above.coarse
    if coarse is None or config.retrieved_views:
        lifted = Ballot(len(work.scene.gaussians))
        _ask_views(work, localization, index, lifted)
        # Whatever shines through is let in here: the ring draws the coarse set alone, and so
        # sees and judges what was hidden from the views.
        seeds = lifted.share >= config.keep_at
        coarse = seeds if coarse is None else coarse | seeds
        if config.retrieved_views:
            ballot = lifted
    if not coarse.any():
        return Segmented(coarse, coarse.astype(np.float32), above.view)
    ring = look_around(work, coarse, place, text)
    if not config.soft_vote:
        return _intersection(work, coarse, above.view, ring)
    with step("ring filters"):
        for view in ring:
            _add_virtual(work, ballot, view, place.location)
        if above.coarse is not None:
            _add_virtual(work, ballot, above.view, place.location, above.weights)
    if ballot.views < LEAST_VOTING_VIEWS:
        return Segmented(coarse, coarse.astype(np.float32), above.view, ring)
    return _count(work, ballot, coarse, above.view, ring)


def _ask_views(work: Workplace, localization: Localization, index: int, ballot: Ballot) -> None:
    """The retrieved views vote with their own patches."""
    scene, patches = work.scene, work.books.semantics.patches
    supporters = localization.labels == index
    own: dict[int, list[int]] = {}
    trust: dict[int, float] = {}
    retrieval = localization.retrieval
    for view, patch, relevancy in zip(
        retrieval.views[supporters],
        retrieval.patches[supporters],
        retrieval.relevancies[supporters],
        strict=True,
    ):
        i = int(view)
        own.setdefault(i, []).append(int(patch))
        trust[i] = max(trust.get(i, LEAST_TRUST), float(relevancy))
    location = localization.places[index].location
    chosen = spread_views(
        np.stack([scene.views[i].camera.position for i in own]),
        location,
        np.array([trust[i] for i in own]),
        work.config.vote_views,
    )
    names = list(own)
    asked = [names[j] for j in chosen]

    def weights(i: int) -> Weights:
        mask = np.logical_or.reduce([patches.pixels(patch) for patch in own[i]])
        return work.view_weights(i, mask)

    with step("retrieved views"):
        for i, vote in zip(asked, in_order(weights, asked, available_threads()), strict=True):
            ballot.add(vote, trust[i] * work.pixel_area(scene.views[i].camera, location))


def spread_views(
    eyes: Float64Array, location: Float64Array, trust: Float64Array, most: int
) -> list[int]:
    """Views that look from as many directions as possible, the most trusted one first.

    Args:
        eyes: (v, 3) camera centres.
        location: (3,) what they look at.
        trust: (v,) how much each counts.
        most: How many to take.

    Returns:
        Indices, in ascending order.
    """
    if len(eyes) <= most:
        return list(range(len(eyes)))
    directions = eyes - location
    directions = directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
    chosen = [int(np.argmax(trust))]
    nearest = directions @ directions[chosen[0]]
    while len(chosen) < most:
        nearest[chosen] = np.inf
        chosen.append(int(np.argmin(nearest)))
        nearest = np.maximum(nearest, directions @ directions[chosen[-1]])
    return sorted(chosen)


def _add_virtual(
    work: Workplace,
    ballot: Ballot,
    view: VirtualView,
    location: Float64Array,
    weights: Weights | None = None,
) -> None:
    """A virtual view votes on what it has drawn; without a detection it abstains."""
    if view.mask is None or view.mask.area == 0 or view.frame.shown is None:
        return
    camera = view.frame.camera
    trust = max(LEAST_TRUST, view.mask.score) * work.pixel_area(camera, location)
    if weights is None:
        weights = work.weights(camera, view.mask.pixels, view.frame.shown)
    ballot.add(weights, trust)


def _count(
    work: Workplace,
    ballot: Ballot,
    coarse: BoolArray,
    bev: VirtualView | None = None,
    ring: Sequence[VirtualView] = (),
) -> Segmented:
    """The answer of the votes: what is seen by its share, the rest by its neighbours."""
    share, seen = ballot.share, ballot.seen
    flags = np.where(seen, share >= work.config.keep_at, coarse)
    if work.config.cleanup:
        with step("neighbours"):
            means = work.scene.gaussians.means
            flags = follow_neighbours(means, flags, seen, work.config.neighbours)
    scores = np.where(flags, np.maximum(share, 0.5), np.minimum(share, 0.49))
    return Segmented(flags, scores.astype(np.float32), bev, ring)


def _intersection(
    work: Workplace, coarse: BoolArray, bev: VirtualView, ring: Sequence[VirtualView]
) -> Segmented:
    """The paper's rule: what every ring view keeps, and nothing where one has no detection.

    Nobody votes then: neither the retrieved views, which only help to make the coarse set, nor
    the view from above.
    """
    flags, ballot = coarse.copy(), Ballot(len(coarse))
    for view in ring:
        if view.mask is None or view.frame.shown is None:
            flags[:] = False
            break
        camera, mask = view.frame.camera, view.mask.pixels
        flags &= work.keeps(camera, mask, coarse, work.weights(camera, mask, coarse))
        ballot.add(work.weights(camera, mask, view.frame.shown), 1.0)
    if work.config.cleanup and flags.any():
        means = work.scene.gaussians.means
        flags = follow_neighbours(means, flags, ballot.seen, work.config.neighbours)
    return Segmented(flags, flags.astype(np.float32), bev, ring)
