"""(B) Retrieval for localising (RFL): text -> a patch in each view -> L_2D -> L_3D -> votes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gvr_core.books import DepthBook, SemanticVectorBook
from gvr_core.paper import VOTE_RADIUS_FRACTION
from gvr_core.scene import View

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


def relevancy(features: NDArray[np.float32], text: NDArray[np.float32]) -> NDArray[np.float32]:
    """Similarity of every patch to the text: the cosine, as in the paper.

    Args:
        features: (M, c) unit vectors.
        text: (c,) unit vector.

    Returns:
        (M,) in [-1, 1].
    """
    scores: NDArray[np.float32] = features @ text
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
    views = np.flatnonzero(np.diff(view_ptr) > 0)
    best = [view_ptr[i] + int(np.argmax(scores[view_ptr[i] : view_ptr[i + 1]])) for i in views]
    return views, np.array(best, dtype=np.int64)


def patch_position(pixels: NDArray[np.bool_]) -> tuple[float, float]:
    """L_2D: the pixel of a patch that is nearest to the patch's centroid.

    The paper says "position" of the patch. The centroid of a concave patch can lie beside it,
    on something else; the nearest pixel of the patch never does.

    Args:
        pixels: (H, W) mask, not empty.

    Returns:
        (x, y) of that pixel's centre.
    """
    rows, columns = np.nonzero(pixels)
    offset = (rows - rows.mean()) ** 2 + (columns - columns.mean()) ** 2
    nearest = int(np.argmin(offset))
    return float(columns[nearest]) + 0.5, float(rows[nearest]) + 0.5


def retrieve(
    book: SemanticVectorBook,
    depths: DepthBook,
    views: Sequence[View],
    text: NDArray[np.float32],
    top_k: int | None = None,
    depth_kind: str = "expected",
) -> Retrieval:
    """The best patch of each view, back-projected: L_2D and L_3D per view.

    A view abstains where it has no patch, or no depth at its patch's position.

    Args:
        book: B_s.
        depths: B_d.
        views: The n knowledge views.
        text: (c,) unit vector of the query.
        top_k: Keep only so many views, those with the most similar patches; None keeps all.
        depth_kind: ``"expected"`` (the paper's) or ``"median"``.
    """
    scores = relevancy(book.vectors, text)
    chosen_views, chosen = best_patches(scores, book.patches.view_ptr)
    if top_k is not None and len(chosen) > top_k:
        order = np.sort(np.argsort(-scores[chosen], kind="stable")[:top_k])
        chosen_views, chosen = chosen_views[order], chosen[order]

    kept, pixels, points = [], [], []
    for j, (i, patch) in enumerate(zip(chosen_views, chosen, strict=True)):
        x, y = patch_position(book.patches.pixels(int(patch)))
        z = float(depths.depth(int(i), depth_kind)[int(y), int(x)])
        if z > 0:
            kept.append(j)
            pixels.append((x, y))
            points.append(views[i].camera.unproject((x, y), z))
    return Retrieval(
        chosen_views[kept],
        chosen[kept],
        scores[chosen[kept]],
        np.array(pixels, dtype=np.float64).reshape(-1, 2),
        np.array(points, dtype=np.float64).reshape(-1, 3),
    )


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
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    near = distances <= radius
    votes = near.sum(axis=1)
    spread = np.where(near, distances, 0.0).sum(axis=1)
    winner = int(np.lexsort((spread, -votes))[0])
    voters: NDArray[np.bool_] = near[winner]
    return voters


def localize(
    book: SemanticVectorBook,
    depths: DepthBook,
    views: Sequence[View],
    text: NDArray[np.float32],
    top_k: int | None = None,
    depth_kind: str = "expected",
    radius_fraction: float = VOTE_RADIUS_FRACTION,
) -> Localization | None:
    """RFL, the whole of it: where in the scene the text is.

    Args:
        book: B_s.
        depths: B_d.
        views: The n knowledge views.
        text: (c,) unit vector of the query.
        top_k: Keep only so many views; None keeps all.
        depth_kind: ``"expected"`` (the paper's) or ``"median"``.
        radius_fraction: See :func:`voting_radius`.

    Returns:
        One place, the mean of the agreeing views' points; its weight, and the confidence, are the
        share of the views that agree times their mean relevancy. None where no view puts a point
        forward.
    """
    retrieval = retrieve(book, depths, views, text, top_k, depth_kind)
    if len(retrieval.points) == 0:
        return None
    radius = voting_radius(retrieval, views, radius_fraction)
    supporters = vote(retrieval.points, radius)
    support = float(supporters.mean() * retrieval.relevancies[supporters].mean())
    place = Place(retrieval.points[supporters].mean(axis=0), radius, support)
    labels = np.where(supporters, 0, -1).astype(np.int64)
    return Localization(retrieval, labels, (place,), radius, confidence=support)
