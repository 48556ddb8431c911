"""A benchmark without a framework: scenes, a method, its queries and their metrics in a loop.

This is what a run of a suite costs at the least, and the yardstick of ``overhead.py``. It calls
gvr_core alone, for the same scenes, method, models and protocols as the flow, and scores every
answer as the flow does; it keeps nothing, draws no pictures, and tracks nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from datasets.base import SceneData
from datasets.gallery import GalleryDataset
from datasets.registry import data_root
from gvr_core.methods import Grounding, MethodConfig, Toolbox, build_method
from gvr_core.metrics import FLAGS_3D, REFUSAL, flags_3d, refusal, truth_box
from gvr_core.models.oracle import OracleWorld
from gvr_core.models.registry import ModelConfig, build_models, needs_world
from gvr_core.protocols import protocol
from gvr_core.protocols.base import ViewPrediction, ViewTruth
from gvr_core.rendering import Renderer, get_renderer
from gvr_core.scene import Query

Scores = dict[str, dict[str, float]]
"""``scene query view protocol`` -> metrics."""


def run_loop(
    scenes: Sequence[str], method: str, models: ModelConfig, limit: int | None = None
) -> Scores:
    """Ground every query of every scene, and score the answers.

    Args:
        scenes: Of the gallery.
        method: A method's name.
        models: The models; the method's own encoder, where it demands one, takes their place.
        limit: Only the first so many queries of each scene.
    """
    config, renderer = MethodConfig(method=method), get_renderer("numba")
    if config.encoder_override:
        models = models.model_copy(update={"encoder": config.encoder_override})
    dataset, scores = GalleryDataset(data_root() / "gallery"), Scores()
    for name in scenes:
        data = dataset.load(name)
        world = known_world(data) if needs_world(models) else None
        ways = build_method(config, Toolbox(renderer, build_models(models, world)))
        books = ways.prepare(data.scene)
        for query in data.queries[:limit]:
            answer = ways.ground(data.scene, books, query)
            for place, metrics in scored(data, query, answer, renderer):
                scores[f"{name} {query.id} {place}"] = metrics
    return scores


def known_world(data: SceneData) -> OracleWorld:
    """The truth of a labelled scene, for models that know it."""
    truth = data.truth
    if truth.labels is None:
        raise ValueError(f"the Gaussians of {data.scene.name} are not labelled")
    meanings = {query.text: query.target for query in data.queries if query.target is not None}
    return OracleWorld(data.scene.gaussians, truth.labels, truth.objects, meanings)


def scored(
    data: SceneData, query: Query, answer: Grounding, renderer: Renderer
) -> Iterator[tuple[str, dict[str, float]]]:
    """``view protocol`` and metrics, under all protocols of a scene with exact truth."""
    truth, gaussians = data.truth, data.scene.gaussians
    ids = data.protocols
    if REFUSAL in ids and (query.target is not None or query.absent):
        yield f"None {REFUSAL}", refusal(answer.found, absent=query.target is None)
    if query.target is None:
        return
    flags = truth.flags(query.target)
    if FLAGS_3D in ids and flags is not None:
        yield f"None {FLAGS_3D}", flags_3d(answer.flags, flags, gaussians.means, answer.location)
    grey = np.repeat(answer.flags[:, None], 3, axis=1).astype(np.float32)
    for view in truth.test_views:
        if not truth.is_labelled(view, query.target):
            continue
        mask = truth.mask(view, query.target)
        if not mask.any():
            continue
        soft = renderer.render(gaussians.recoloured(grey), view.camera).rgb[..., 0]
        pixel = None
        if answer.location is not None:
            xy, z = view.camera.project(answer.location)
            pixel = (float(xy[0]), float(xy[1])) if z > 0 else None
        for spec in filter(lambda spec: spec.score_pair, map(protocol, ids)):
            metrics = spec.score_pair(
                ViewPrediction(soft, pixel=pixel), ViewTruth(mask, (truth_box(mask),))
            )
            if metrics:
                yield f"{view.name} {spec.id}", metrics
