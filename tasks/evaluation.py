"""Scoring a method's answers on one scene: rows of metrics, and a picture of each query."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datasets.base import SceneData
from gvr_core.exports import RED
from gvr_core.gaussians import Gaussians
from gvr_core.metrics import (
    FLAGS_3D,
    IN_SCENE_2D,
    REFUSAL,
    flags_3d,
    in_scene_2d,
    refusal,
)
from gvr_core.rendering import Renderer
from gvr_core.scene import Query, View
from reports.pictures import query_picture
from tasks.groundings import Answer

Scored = dict[str, Any]
"""A row without the names of data set, scene and method: query, view, protocol, metrics."""

VIEWS_LOOKED_THROUGH = 8
"""Without test views, about so many knowledge views are tried for a query's picture."""


def soft_prediction(
    gaussians: Gaussians, answer: Answer, view: View, renderer: Renderer
) -> NDArray[np.float32]:
    """(H, W) share of each pixel's colour that comes from the target, the rest occluding it."""
    # The protocol says flags: methods that also know how sure they are must not gain by it.
    grey = np.repeat(answer.flags[:, None], 3, axis=1).astype(np.float32)
    soft: NDArray[np.float32] = renderer.render(gaussians.recoloured(grey), view.camera).rgb[..., 0]
    return soft


def score_query(
    data: SceneData, query: Query, answer: Answer, renderer: Renderer
) -> tuple[list[Scored], int]:
    """All rows of one query.

    Args:
        data: The scene and its truth.
        query: The query.
        answer: What the method said.
        renderer: Draws the prediction in the test views.

    Returns:
        The rows, and the number of test views left out because they do not show the object.
    """

    def row(protocol: str, view: str | None, metrics: dict[str, float]) -> Scored:
        return {"query": query.id, "view": view, "protocol": protocol, "metrics": metrics}

    if query.target is None:
        if not query.absent:  # nobody knows the answer, so nothing can be scored
            return [], 0
        return [row(REFUSAL, None, refusal(answer.found, absent=True))], 0
    rows = [row(REFUSAL, None, refusal(answer.found, absent=False))]
    gaussians, truth = data.scene.gaussians, data.truth
    flags = truth.flags(query.target)
    if flags is not None:
        metrics = flags_3d(answer.flags, flags, gaussians.means, answer.location)
        rows.append(row(FLAGS_3D, None, metrics))
    unseen = 0
    for view in truth.test_views:
        mask = truth.mask(view, query.target)
        if not mask.any():
            unseen += 1
            continue
        pixel = None
        if answer.location is not None:
            xy, z = view.camera.project(answer.location)
            pixel = (float(xy[0]), float(xy[1])) if z > 0 else None
        soft = soft_prediction(gaussians, answer, view, renderer)
        rows.append(row(IN_SCENE_2D, view.name, in_scene_2d(soft, mask, pixel)))
    return rows, unseen


def draw_query(
    data: SceneData, query: Query, answer: Answer, rows: Sequence[Scored], renderer: Renderer
) -> bytes:
    """The picture of a query: the target dyed red, splatted into a test view, with the truth.

    The view is the one that shows most of the object. Where nobody knows the object, it is the
    one of a few that shows most of the answer.

    Args:
        data: The scene and its truth.
        query: The query.
        answer: What the method said.
        rows: The query's rows, for the caption.
        renderer: Draws it.

    Returns:
        A PNG.
    """
    view, mask = _best_view(data, query, answer, renderer)
    dyed = data.scene.gaussians.dyed(answer.flags, RED)
    image = renderer.render(dyed, view.camera).rgb
    parts = []
    for scored in rows:
        if scored["protocol"] == IN_SCENE_2D and scored["view"] == view.name:
            parts.append(f"IoU {100 * scored['metrics']['iou']:.0f}")
        if scored["protocol"] == FLAGS_3D:
            parts.append(f"3D IoU {100 * scored['metrics']['iou']:.0f}")
    if query.absent:
        parts.append("not in the scene")
    if not answer.found:
        parts.append("nothing found")
    return query_picture(image, mask, f"“{query.text}”\n{' · '.join(parts)}".strip())


def _best_view(
    data: SceneData, query: Query, answer: Answer, renderer: Renderer
) -> tuple[View, NDArray[np.bool_] | None]:
    tests = data.truth.test_views
    if tests and query.target is None:
        return tests[0], None
    if tests and query.target is not None:
        masks = [data.truth.mask(view, query.target) for view in tests]
        best = int(np.argmax([mask.sum() for mask in masks]))
        return tests[best], masks[best]
    views = data.scene.views
    few = views[:: max(1, len(views) // VIEWS_LOOKED_THROUGH)]
    soft = [soft_prediction(data.scene.gaussians, answer, view, renderer).sum() for view in few]
    return few[int(np.argmax(soft))], None
