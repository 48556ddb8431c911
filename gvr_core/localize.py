"""(B) Retrieval for localising (RFL): text -> a patch in each view -> L_2D -> L_3D -> votes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from gvr_core.books import DepthBook, PatchBook
from gvr_core.cameras import unproject_each
from gvr_core.paper import VOTE_RADIUS_FRACTION
from gvr_core.run_lengths import patch_positions
from gvr_core.scene import View
from gvr_core.stopwatch import step

Float64Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Retrieval:
    """The patch that each voting view puts forward, and where it lies in 3D."""

    views: NDArray[np.int64]
    """(v,) indices of the views that put a patch forward."""
    patches: NDArray[np.int64]
    """(v,) index of each view's best patch in the Semantic Vector Book."""
    relevancies: NDArray[np.float32]
    """(v,) relevancy of that patch."""
    pixels: Float64Array
    """(v, 2) L_2D: the patch's position (x, y), pixels."""
    points: Float64Array
    """(v, 3) L_3D of each view, world frame."""


@dataclass(frozen=True, eq=False)
class Place:
    """One place at which the views agree that the object is."""

    location: Float64Array
    """(3,) L_3D, world frame, scene units."""
    radius: float
    """How far the object, or the vote, reaches around it, scene units."""
    weight: float
    """What speaks for it; comparable between the places of one localisation."""


@dataclass(frozen=True, eq=False)
class Localization:
    """Where the object is, and the vote that led there."""

    retrieval: Retrieval
    """The patches that were put forward."""
    labels: NDArray[np.int64]
    """(v,) index of the place that each of them supports, -1 for none."""
    places: tuple[Place, ...]
    """Where the object is, the place with the most behind it first; the paper's method has
    exactly one, others may find several instances or none."""
    radius: float
    """Voting radius: points nearer than this support each other. Scene units."""
    confidence: float
    """How sure it is; comparable only within one method and its models."""
    is_stuff: bool = False
    """Whether it is an area (a lawn, a wall) rather than a thing with a place of its own."""

    @property
    def location(self) -> Float64Array | None:
        """(3,) L_3D: the first place, world frame; None where there is none."""
        return self.places[0].location if self.places else None

    @property
    def supporters(self) -> NDArray[np.bool_]:
        """(v,) flags of the patches that support the first place."""
        return np.asarray(self.labels == 0)


TEXTS_A_BLOCK = 16
"""Texts that are multiplied at once; fewer are filled up with zeros."""
POINTS_A_CHUNK = 1024
"""Points whose distances to all others are held at once, which bounds the memory."""
PATCHES_A_CHUNK = 8192
"""Patches that are multiplied at once, which bounds the memory."""


def relevancy(features: NDArray[np.floating], texts: NDArray[np.float32]) -> NDArray[np.float32]:
    """Similarity of every patch to every text: the cosine, as in the paper.

    Every product has the same shape, so that a text's cosines are the same to the last bit
    whichever other texts are asked for with it.

    Args:
        features: (M, c) unit vectors, float32 or float16; may lie in a file (a memory map).
        texts: (t, c) unit vectors.

    Returns:
        (t, M) float32, in [-1, 1].
    """
    m, t = len(features), len(texts)
    scores = np.empty((t, m), np.float32)
    blocks = np.zeros((-(-t // TEXTS_A_BLOCK), TEXTS_A_BLOCK, texts.shape[1]), np.float32)
    blocks.reshape(-1, texts.shape[1])[:t] = texts
    for start in range(0, m, PATCHES_A_CHUNK):
        chunk = np.asarray(features[start : start + PATCHES_A_CHUNK], np.float32)
        for i, block in enumerate(blocks):
            first = i * TEXTS_A_BLOCK
            own = scores[first : first + TEXTS_A_BLOCK, start : start + PATCHES_A_CHUNK]
            own[:] = (chunk @ block.T).T[: len(own)]
    return scores


def best_patches(
    scores: NDArray[np.float32], view_ptr: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The most similar patch of each view; the first one where several are equally similar.

    Args:
        scores: (M,) relevancies.
        view_ptr: (n + 1,) where each view's patches begin.

    Returns:
        The views that have a patch (v,), and the best patch of each (v,).
    """
    counts = np.diff(view_ptr)
    views = np.flatnonzero(counts > 0)
    if len(views) == 0:
        return views, np.empty(0, np.int64)
    highest = np.maximum.reduceat(scores, view_ptr[:-1][views])
    best = np.flatnonzero(scores == np.repeat(highest, counts[views]))
    return views, best[np.searchsorted(best, view_ptr[:-1][views])]


def retrieve(
    scores: NDArray[np.float32],
    patches: PatchBook,
    depths: DepthBook,
    views: Sequence[View],
    top_k: int | None = None,
    depth_kind: str = "expected",
) -> Retrieval:
    """The best patch of each view, back-projected: L_2D and L_3D per view.

    A view abstains where it has no patch, or no depth at its patch's position.

    Args:
        scores: (M,) relevancy of every patch to the query.
        patches: The M patches.
        depths: B_d.
        views: The n knowledge views.
        top_k: Keep only so many views, those with the most similar patches; None keeps all.
        depth_kind: ``"expected"`` (the paper's) or ``"median"``.
    """
    with step("best patches"):
        chosen_views, chosen = best_patches(scores, patches.view_ptr)
        if top_k is not None and len(chosen) > top_k:
            order = np.sort(np.argsort(-scores[chosen], kind="stable")[:top_k])
            chosen_views, chosen = chosen_views[order], chosen[order]
    with step("back-projection"):
        pixels = patch_positions(patches, chosen)
        z = depths_at(depths, chosen_views, pixels, depth_kind)
        kept = z > 0
        chosen_views, chosen, pixels = chosen_views[kept], chosen[kept], pixels[kept]
        points = unproject_each([views[i].camera for i in chosen_views], pixels, z[kept])
    return Retrieval(chosen_views, chosen, scores[chosen], pixels, points)


def depths_at(
    depths: DepthBook,
    views: NDArray[np.int64],
    pixels: Float64Array,
    kind: str = "expected",
) -> Float64Array:
    """Depth (v,) of one pixel (v, 2) of each of some views (v,), scene units."""
    found = [
        depths.depth(int(i), kind)[int(y), int(x)] for i, (x, y) in zip(views, pixels, strict=True)
    ]
    return np.array(found, np.float64)


def voting_radius(
    retrieval: Retrieval, views: Sequence[View], fraction: float = VOTE_RADIUS_FRACTION
) -> float:
    """How near two views' points must be to agree, in scene units.

    The paper compares Euclidean distances and names no scale. Ours is relative to how far away
    the views look, so that it does not depend on the scene's units.

    Args:
        retrieval: The points of the views.
        views: The n knowledge views.
        fraction: Of the median distance from a camera to its own point.
    """
    eyes = np.stack([views[i].camera.position for i in retrieval.views])
    return fraction * float(np.median(np.linalg.norm(retrieval.points - eyes, axis=1)))


def vote(points: Float64Array, radius: float) -> NDArray[np.bool_]:
    """Multi-view stereo voting: the views agree by Euclidean distance of their points.

    Every point gets a vote from each point within the radius, itself included. The point with
    the most votes wins; of several, the one with the smallest sum of distances to its voters;
    of several still, the first.

    Args:
        points: (v, 3), world frame, v >= 1.
        radius: Scene units.

    Returns:
        (v,) flags of the winner's voters.
    """
    votes, spread = np.empty(len(points), np.int64), np.empty(len(points))
    for start in range(0, len(points), POINTS_A_CHUNK):
        part = slice(start, start + POINTS_A_CHUNK)
        distances = cdist(points[part], points)
        near = distances <= radius
        votes[part] = near.sum(axis=1)
        spread[part] = np.where(near, distances, 0.0).sum(axis=1)
    winner = int(np.lexsort((spread, -votes))[0])
    voters: NDArray[np.bool_] = cdist(points[winner : winner + 1], points)[0] <= radius
    return voters


def localize(
    scores: NDArray[np.float32],
    patches: PatchBook,
    depths: DepthBook,
    views: Sequence[View],
    top_k: int | None = None,
    depth_kind: str = "expected",
    radius_fraction: float = VOTE_RADIUS_FRACTION,
) -> Localization | None:
    """RFL, from relevancies on: where in the scene the text is.

    Args:
        scores: (M,) relevancy of every patch to the query; see :func:`relevancy`.
        patches: The M patches.
        depths: B_d.
        views: The n knowledge views.
        top_k: Keep only so many views; None keeps all.
        depth_kind: ``"expected"`` (the paper's) or ``"median"``.
        radius_fraction: See :func:`voting_radius`.

    Returns:
        One place, the mean of the agreeing views' points; its weight, and the confidence, are the
        share of the views that agree times their mean relevancy. None where no view puts a point
        forward.
    """
    retrieval = retrieve(scores, patches, depths, views, top_k, depth_kind)
    if len(retrieval.points) == 0:
        return None
    with step("voting"):
        radius = voting_radius(retrieval, views, radius_fraction)
        supporters = vote(retrieval.points, radius)
    support = float(supporters.mean() * retrieval.relevancies[supporters].mean())
    place = Place(retrieval.points[supporters].mean(axis=0), radius, support)
    labels = np.where(supporters, 0, -1).astype(np.int64)
    return Localization(retrieval, labels, (place,), radius, confidence=support)
