"""The picture of a query: the target dyed red in a view, the truth outlined, the scores below."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from datasets.base import SceneData
from gvr_core.exports import RED
from gvr_core.metrics import FLAGS_3D
from gvr_core.rendering import Renderer
from gvr_core.scene import Query, View
from reports.pictures import query_picture
from tasks.evaluation import Scored, predict, soft_prediction
from tasks.groundings import Answer

VIEWS_LOOKED_THROUGH = 8
"""Without test views, about so many knowledge views are tried for a query's picture."""

DYE_SHARE = 0.6
"""How much of the colour of a given mask's pixels is dye."""


def draw_query(
    data: SceneData, query: Query, answer: Answer, rows: Sequence[Scored], renderer: Renderer
) -> bytes:
    """The target dyed red, splatted into a test view, with the truth.

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
    view, mask = best_view(data, query, answer, renderer)
    parts = [
        f"IoU {100 * scored['metrics']['iou']:.0f}"
        for scored in rows
        if scored["protocol"] == data.protocols[0]
        and scored["view"] == view.name
        and "iou" in scored["metrics"]
    ]
    parts += [
        f"3D IoU {100 * scored['metrics']['iou']:.0f}"
        for scored in rows
        if scored["protocol"] == FLAGS_3D
    ]
    if query.absent:
        parts.append("not in the scene")
    if not answer.found:
        parts.append("nothing found")
    caption = f"“{query.text}”\n{' · '.join(parts)}".strip()
    return query_picture(dyed(data, answer, view, renderer), mask, caption)


def dyed(data: SceneData, answer: Answer, view: View, renderer: Renderer) -> NDArray[np.float32]:
    """(H, W, 3) a view of the scene with the answer dyed red."""
    gaussians = data.scene.gaussians
    if answer.given is None:
        return renderer.render(gaussians.dyed(answer.flags, RED), view.camera).rgb
    image = renderer.render(gaussians, view.camera).rgb
    share = DYE_SHARE * predict(data, answer, view, renderer).soft[..., None]
    mixed: NDArray[np.float32] = image * (1 - share) + np.array(RED, np.float32) * share
    return mixed


def best_view(
    data: SceneData, query: Query, answer: Answer, renderer: Renderer
) -> tuple[View, NDArray[np.bool_] | None]:
    """The view that shows most of the object, and the truth in it; see :func:`draw_query`."""
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
