"""Scoring a method's answers on one scene under the protocols of its data set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.base import SceneData
from gvr_core.errors import DatasetError, some_of
from gvr_core.gaussians import Gaussians
from gvr_core.metrics import FLAGS_3D, REFUSAL, flags_3d, refusal, truth_box
from gvr_core.protocols import protocol
from gvr_core.protocols.base import ProtocolSpec, ViewPrediction, ViewTruth
from gvr_core.rendering import Renderer
from gvr_core.scene import Query, View
from tasks.groundings import Answer

SKIPPED = "skipped"
"""Metric, always 1, of a labelled pair that its protocol gives no number for: the prediction was
not made, or is of a kind that it does not know. Such a pair was expected, and is not covered."""

PLACED = "acc_center"
"""Metric of L_3D, which pictures do not have: a zero would say that it was wrong."""

Scored = dict[str, Any]
"""A row without the names of data set, scene and method: query, view, protocol, metrics."""


@dataclass(frozen=True)
class SceneScores:
    """What scoring a scene gave."""

    rows: list[Scored]
    """In the order of queries; a pair that the protocol skips has only :data:`SKIPPED`."""
    unlabelled: int
    """(query, test view) pairs left out because the object is not labelled there."""
    left_out: int
    """(query, test view, protocol) triples left out because their truth is empty, and for most
    protocols the prediction too."""


def score_scene(
    data: SceneData,
    queries: Sequence[Query],
    answers: Sequence[Answer],
    renderer: Renderer,
    protocols: Sequence[str] | None = None,
) -> SceneScores:
    """All rows of a scene.

    Args:
        data: The scene and its truth.
        queries: The queries.
        answers: What the method said, one for each query.
        renderer: Draws the predictions in the test views.
        protocols: Ids of the protocols; the data set's own where None.

    Raises:
        ConfigError: for a protocol that is not known.
        DatasetError: for a given picture that is not of its view's size, or of no test view.
    """
    _check_views(data, answers)
    ids = data.protocols if protocols is None else tuple(protocols)
    specs = [
        spec
        for spec in map(protocol, ids)
        # Classes that were not asked for cannot compete, so a part of the queries is no contest.
        if spec.score_pair or (spec.score_view and len(queries) == len(data.queries))
    ]
    rows: list[list[Scored]] = [
        _without_views(data, query, answer, ids)
        for query, answer in zip(queries, answers, strict=True)
    ]
    unlabelled = left_out = 0
    for view in data.truth.test_views:
        asked = [i for i, query in enumerate(queries) if query.target is not None]
        shown = [i for i in asked if data.truth.is_labelled(view, str(queries[i].target))]
        unlabelled += len(asked) - len(shown)
        truths = {i: view_truth(data, view, str(queries[i].target)) for i in shown}
        isolated = any(spec.needs_isolated for spec in specs)
        said = {i: predict(data, answers[i], view, renderer, isolated) for i in shown}
        for spec in specs:
            for i, metrics in _in_view(spec, queries, said, truths).items():
                if not metrics and not truths[i].mask.any():
                    left_out += 1
                    continue
                counted = dict(metrics or {SKIPPED: 1.0})
                if answers[i].given is not None:
                    counted.pop(PLACED, None)
                rows[i].append(_row(queries[i], spec.id, view.name, counted))
    return SceneScores([row for of_query in rows for row in of_query], unlabelled, left_out)


def predict(
    data: SceneData, answer: Answer, view: View, renderer: Renderer, isolated: bool = False
) -> ViewPrediction:
    """What an answer says in a view.

    Args:
        data: The scene.
        answer: Flags of Gaussians, or pictures.
        view: The view.
        renderer: Draws flags.
        isolated: Also draw the target alone.

    Raises:
        DatasetError: for a given picture that is not of the view's size.
    """
    if answer.given is not None:
        return _given(answer.given.get(view.name), view)
    if not answer.answered:
        return _given(None, view)
    gaussians = data.scene.gaussians
    alone = None
    if isolated:
        alone = np.zeros((view.camera.height, view.camera.width), np.float32)
        if answer.flags.any():
            alone = renderer.render(gaussians.subset(answer.flags), view.camera).alpha
    pixel = None
    if answer.location is not None:
        xy, z = view.camera.project(answer.location)
        pixel = (float(xy[0]), float(xy[1])) if z > 0 else None
    return ViewPrediction(soft_prediction(gaussians, answer, view, renderer), alone, pixel=pixel)


def soft_prediction(
    gaussians: Gaussians, answer: Answer, view: View, renderer: Renderer
) -> NDArray[np.float32]:
    """(H, W) share of each pixel's colour that comes from the target, the rest occluding it."""
    # The protocols say flags: methods that also know how sure they are must not gain by it.
    grey = np.repeat(answer.flags[:, None], 3, axis=1).astype(np.float32)
    soft: NDArray[np.float32] = renderer.render(gaussians.recoloured(grey), view.camera).rgb[..., 0]
    return soft


def view_truth(data: SceneData, view: View, target: str) -> ViewTruth:
    """The labels of an object in a test view where it is labelled."""
    mask = data.truth.mask(view, target)
    boxes = data.truth.boxes.get((view.name, target), ())
    if not boxes and mask.any():
        boxes = (truth_box(mask),)
    return ViewTruth(mask, boxes)


def _without_views(
    data: SceneData, query: Query, answer: Answer, ids: Sequence[str]
) -> list[Scored]:
    """Rows of the protocols that score no views."""
    rows: list[Scored] = []
    if query.target is None and not query.absent:  # nobody knows the answer
        return rows
    # Who has not answered has not refused either.
    if REFUSAL in ids and answer.answered:
        found = answer.found
        if answer.given is not None:
            tests = (answer.given.get(view.name) for view in data.truth.test_views)
            found = any(picture is not None and picture.any() for picture in tests)
        rows.append(_row(query, REFUSAL, None, refusal(found, absent=query.target is None)))
    flags = None if query.target is None else data.truth.flags(query.target)
    if FLAGS_3D in ids and flags is not None and answer.given is None:
        metrics = flags_3d(answer.flags, flags, data.scene.gaussians.means, answer.location)
        rows.append(_row(query, FLAGS_3D, None, metrics))
    return rows


def _check_views(data: SceneData, answers: Sequence[Answer]) -> None:
    """Refuse pictures of views that nothing is labelled in: they would be passed over."""
    known = {view.name for view in data.truth.test_views}
    strange = {name for answer in answers for name in answer.given or ()} - known
    if strange:
        raise DatasetError(
            f"predictions for {some_of(sorted(strange))}, where nothing is labelled",
            accepted=f"the test views of {data.scene.name}: {some_of(sorted(known), 12)}",
        )


def _in_view(
    spec: ProtocolSpec,
    queries: Sequence[Query],
    said: dict[int, ViewPrediction],
    truths: dict[int, ViewTruth],
) -> dict[int, dict[str, float] | None]:
    """Metrics of each query that a view is labelled for; None where the pair does not count."""
    if spec.score_pair is not None:
        return {i: spec.score_pair(said[i], truths[i]) for i in said}
    if spec.score_view is None or not said:
        return {}
    # Prompts compete for the pixels, so each object takes part once, whatever its wordings.
    first = {str(queries[i].target): i for i in reversed(said)}
    scored = spec.score_view(
        {target: said[i] for target, i in first.items()},
        {target: truths[i] for target, i in first.items()},
    )
    return {first[target]: metrics for target, metrics in scored.items()}


def _given(picture: NDArray[Any] | None, view: View) -> ViewPrediction:
    size = (view.camera.height, view.camera.width)
    if picture is None:
        return ViewPrediction(np.zeros(size, np.float32), missing=True)
    if picture.shape[-2:] != size:
        raise DatasetError(
            f"a prediction of {picture.shape[-1]} x {picture.shape[-2]} pixels for the view "
            f"{view.name}",
            accepted=f"{size[1]} x {size[0]}, as its labels have",
        )
    if picture.ndim == 3:
        maps = picture.astype(np.float32)
        return ViewPrediction(maps.max(axis=0).clip(0, 1), relevancy=maps)
    return ViewPrediction(picture.astype(np.float32) / np.float32(255))


def _row(query: Query, protocol_id: str, view: str | None, metrics: dict[str, float]) -> Scored:
    return {"query": query.id, "view": view, "protocol": protocol_id, "metrics": metrics}
