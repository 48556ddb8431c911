"""A scene and a method made ready to run, with nothing of Prefect in it."""

from __future__ import annotations

import hashlib
import logging
from functools import partial

from datasets.base import SceneData
from datasets.leakage import without_test_views
from datasets.registry import get_dataset
from flows.lines import Line
from flows.progress import Progress
from flows.suite import DatasetChoice, SuiteConfig
from gvr_core.methods import MethodConfig, Toolbox, check_method
from gvr_core.models.oracle import OracleWorld
from gvr_core.models.registry import ModelConfig, build_models, needs_world
from gvr_core.rendering import get_renderer
from tasks.scene_job import SceneJob
from tasks.store import Store

log = logging.getLogger(__name__)


def make_job(
    data: SceneData,
    method: MethodConfig,
    store: Store,
    models: ModelConfig | None = None,
    renderer: str = "numba",
    limit: int | None = None,
    progress: Progress | None = None,
    name: str = "",
    evidence: bool = False,
) -> SceneJob:
    """One method on one scene, with its models and renderer.

    Args:
        data: The scene.
        method: The method.
        store: Where results of stages lie.
        models: Which models; a method that demands its own encoder gets that.
        renderer: Name of the renderer.
        limit: Only the first so many queries; None for all.
        progress: Shows progress bars; None shows none.
        name: Stands beside the bars; the method's own name where empty.
        evidence: Keep the steps behind each answer as small pictures.

    Raises:
        ConfigError: for a method, model or renderer that is not known, or oracle models on a
            scene whose Gaussians are not labelled.
        ModelError: for weights that are missing or wrong.
    """
    check_method(method.method)
    models = (models if method.needs_books else None) or ModelConfig()
    if method.encoder_override:
        models = models.model_copy(update={"encoder": method.encoder_override})
    world = oracle_world(data, renderer) if needs_world(models) else None
    tools = Toolbox(get_renderer(renderer), build_models(models, world))
    label = f"{data.scene.dataset}/{data.scene.name} · {name or method.shown_name}"
    bars = progress or Progress(shown=False)
    track = partial(bars.track, label=label)
    return SceneJob(store, data, data.queries[:limit], method, tools, track, evidence)


def line_job(
    data: SceneData,
    suite: SuiteConfig,
    line: Line,
    store: Store,
    progress: Progress | None = None,
) -> SceneJob:
    """One line of a suite on one scene.

    Args:
        data: The scene.
        suite: The suite.
        line: The method and its models.
        store: Where results of stages lie.
        progress: Shows progress bars; None shows none.

    Raises:
        ConfigError: as :func:`make_job`.
        ModelError: as :func:`make_job`.
    """
    return make_job(
        data,
        line.method,
        store,
        line.models,
        suite.renderer,
        suite.limit,
        progress,
        line.name,
        suite.evidence and not line.is_variant,  # variants are dozens, and nearly equal
    )


def oracle_world(data: SceneData, renderer: str = "numba") -> OracleWorld | None:
    """The truth of a scene for models that know it; None where its Gaussians are not labelled.

    Args:
        data: The scene.
        renderer: Name of the renderer that draws the truth.
    """
    truth = data.truth
    if truth.labels is None:
        return None
    meanings = {query.text: query.target for query in data.queries if query.target is not None}
    parts = [f"{part}:{data.digests[part]}" for part in ("gaussians", "truth", "queries")]
    digest = hashlib.sha256(" ".join(parts).encode()).hexdigest()
    return OracleWorld(
        data.scene.gaussians, truth.labels, truth.objects, meanings, digest, renderer
    )


def load_scene(choice: DatasetChoice, scene: str, exclude_eval_views: bool = False) -> SceneData:
    """Read one scene of a data set, making it first where the data set makes its own.

    Args:
        choice: The data set.
        scene: Name of the scene.
        exclude_eval_views: Keep test views out of the knowledge views.
    """
    data = get_dataset(choice.name, choice.settings).load(scene)
    if exclude_eval_views:
        data = without_test_views(data)
    for note in data.notes:
        log.warning("%s/%s: %s", data.scene.dataset, data.scene.name, note)
    return data
