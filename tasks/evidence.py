"""The evidence for a scene's answers, gathered from what the stages have kept.

Nothing is grounded again: retrieved patches and votes come from the localisations, virtual views
and their masks from the groundings. Only the answer itself is drawn, in each test view, in small.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.base import SceneData
from gvr_core.books import PatchBook, ViewBook
from gvr_core.gaussians import SH_C0, Gaussians
from gvr_core.localize import Localization
from gvr_core.rendering import Renderer
from gvr_core.scene import Query, View
from reports.evidence import (
    FINAL_WIDTH,
    AgreedPlace,
    Camera,
    Cloud,
    FinalPicture,
    Picture,
    QueryEvidence,
    SceneEvidence,
    VirtualPicture,
    Vote,
    cloud_of,
    outline_path,
    picture_fields,
    thumbnail_size,
    to_webp,
    triple,
)
from tasks.drawing import best_view, dyed
from tasks.groundings import (
    BEV,
    Answer,
    VirtualEvidence,
    unpack_answers,
    unpack_localization,
    unpack_virtual,
)

MOST_FINALS = 12
"""The answer is drawn in at most so many test views."""
ABSENT_FINALS = 2
"""An answer about an absent object, in so many: there is no truth to compare it with."""
CLOUD_POINTS = 3000
"""So many Gaussians stand for the scene behind the votes."""
CLOUD_REACH = 1.5
"""Gaussians further from the cameras' middle than this many times their median distance from it
are left out of the picture: a few far ones would make all others one dot."""


def gather_evidence(
    data: SceneData,
    queries: Sequence[Query],
    groundings: Mapping[str, NDArray[Any]],
    localizations: Mapping[str, Any],
    views: ViewBook | None,
    patches: PatchBook | None,
    renderer: Renderer,
) -> SceneEvidence:
    """The evidence for all answers of a method on a scene.

    Args:
        data: The scene and its truth.
        queries: The queries.
        groundings: As stored: the answers, and the virtual views.
        localizations: Query id -> localisation, as stored.
        views: The rendered knowledge views; None for a method without books.
        patches: Their patches; None for a method without books.
        renderer: Draws the answers.
    """
    answers = unpack_answers(groundings)
    virtual = unpack_virtual(groundings)
    places = [unpack_localization(localizations.get(query.id)) for query in queries]
    retrieved = {int(view) for place in places if place for view in place.retrieval.views}
    cameras = tuple(
        Camera(
            name=view.name,
            position=triple(view.camera.position),
            picture=_knowledge_picture(views, i) if views is not None and i in retrieved else None,
        )
        for i, view in enumerate(data.scene.views)
    )
    found = []
    for i, (query, answer, place) in enumerate(zip(queries, answers, places, strict=True)):
        finals, more = _finals(data, query, answer, renderer)
        found.append(
            QueryEvidence(
                query=query.id,
                votes=() if place is None or patches is None else _votes(place, patches),
                places=() if place is None else _places(place),
                virtual=tuple(_virtual(view) for view in virtual if view.query == i),
                finals=finals,
                n_more_finals=more,
            )
        )
    return SceneEvidence(
        up=triple(data.scene.up_direction),
        cloud=_cloud(data.scene.gaussians, [view.camera.position for view in data.scene.views]),
        cameras=cameras,
        queries=tuple(found),
    )


def _knowledge_picture(views: ViewBook, i: int) -> Picture:
    rgb = views.rgb(i)
    return Picture(**picture_fields(to_webp(rgb), thumbnail_size(rgb.shape[1], rgb.shape[0])))


def _votes(place: Localization, patches: PatchBook) -> tuple[Vote, ...]:
    """The patches that were put forward, the most relevant first."""
    retrieval = place.retrieval
    votes = []
    for j in np.argsort(-retrieval.relevancies, kind="stable"):
        mask = patches.pixels(int(retrieval.patches[j]))
        size = thumbnail_size(mask.shape[1], mask.shape[0])
        x, y = retrieval.pixels[j] * np.array(size) / np.array(mask.shape[::-1])
        votes.append(
            Vote(
                view=int(retrieval.views[j]),
                score=float(f"{retrieval.relevancies[j]:.5g}"),
                point=triple(retrieval.points[j]),
                place=int(place.labels[j]),
                outline=outline_path(mask, size),
                pixel=(round(float(x), 1), round(float(y), 1)),
            )
        )
    return tuple(votes)


def _places(place: Localization) -> tuple[AgreedPlace, ...]:
    return tuple(
        AgreedPlace(
            location=triple(each.location), radius=float(each.radius), weight=float(each.weight)
        )
        for each in place.places
    )


def _virtual(view: VirtualEvidence) -> VirtualPicture:
    return VirtualPicture(
        role="bev" if view.role == BEV else "ring",
        **picture_fields(view.webp, view.size),
        outline=None if view.mask is None else outline_path(view.mask, view.size),
    )


def _finals(
    data: SceneData, query: Query, answer: Answer, renderer: Renderer
) -> tuple[tuple[FinalPicture, ...], int]:
    """The answer in each test view that its object is labelled in, and how many more there are."""
    truth = data.truth
    if query.target is None:
        shown = list(truth.test_views[:ABSENT_FINALS])
        masks: list[NDArray[np.bool_] | None] = [None] * len(shown)
    else:
        shown = [view for view in truth.test_views if truth.is_labelled(view, query.target)]
        masks = [truth.mask(view, query.target) for view in shown[:MOST_FINALS]]
    more = max(0, len(shown) - MOST_FINALS)
    if shown:
        pairs = list(zip(shown, masks, strict=False))
        return tuple(_final(data, answer, v, m, renderer, True) for v, m in pairs), more
    view, mask = best_view(data, query, answer, renderer)
    return (_final(data, answer, view, mask, renderer, view in truth.test_views),), 0


def _final(
    data: SceneData,
    answer: Answer,
    view: View,
    mask: NDArray[np.bool_] | None,
    renderer: Renderer,
    test: bool,
) -> FinalPicture:
    size = thumbnail_size(view.camera.width, view.camera.height, FINAL_WIDTH)
    seen = view
    if answer.given is None:  # pictures of others are of the view's own size
        seen = View(view.name, view.camera.resized(*size))
    rgb = dyed(data, answer, seen, renderer)
    return FinalPicture(
        view=view.name,
        test=test,
        **picture_fields(to_webp(rgb, FINAL_WIDTH), size),
        outline=None if mask is None else outline_path(mask, size),
    )


def _cloud(gaussians: Gaussians, eyes: Sequence[NDArray[np.float64]]) -> Cloud:
    """Gaussians near what the cameras look at: opaque rather than not, small ones too."""
    means = gaussians.means.astype(np.float64)
    middle = np.median(means, axis=0)
    reach = CLOUD_REACH * float(np.median(np.linalg.norm(np.stack(eyes) - middle, axis=1)))
    near = np.linalg.norm(means - middle, axis=1) <= reach
    kept = np.flatnonzero(near & np.isfinite(means).all(axis=1))
    if not len(kept):
        kept = np.arange(len(means))
    # A fixed draw, weighted by what each covers: the same scene looks the same in every report.
    weights = np.maximum(gaussians.opacities[kept].astype(np.float64), 1e-9)
    n = min(CLOUD_POINTS, len(kept))
    chosen = np.random.default_rng(0).choice(kept, n, replace=False, p=weights / weights.sum())
    colours = np.clip(gaussians.sh[chosen, 0] * SH_C0 + 0.5, 0, 1)
    return cloud_of(means[chosen], np.rint(colours * 255))
