"""The scene flow: every stage of every method on one scene, one cached task after the other."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from prefect import flow

from datasets.base import SceneData
from datasets.leakage import without_test_views
from datasets.registry import get_dataset
from flows.lines import Line, file_name
from flows.progress import Progress
from flows.suite import DatasetChoice, SuiteConfig
from gvr_core.errors import GVRError, InputError
from gvr_core.methods import MethodConfig, Toolbox, check_method
from gvr_core.models.oracle import OracleWorld
from gvr_core.models.registry import ModelConfig, build_models, needs_world
from gvr_core.rendering import get_renderer
from gvr_core.scene import Query
from reports.record import QueryOutcome, Row, SceneResult, StageTiming
from tasks.evaluation import Scored
from tasks.groundings import Answer, unpack_answers
from tasks.stage import StageRun
from tasks.stages import PREPARATION, SceneJob, run_stages
from tasks.store import Store

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SceneOutcome:
    """What one line on one scene gave: its result, its rows, and its pictures in the store."""

    result: SceneResult
    rows: tuple[Row, ...] = ()
    pictures: dict[str, Path] = field(default_factory=dict)
    """Path relative to the result's folder -> the picture, or the evidence, in the store."""
    bad_input: bool = False
    """Whether it failed for something the user gave."""


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


@flow(name="scene", flow_run_name="{dataset}/{scene}", validate_parameters=False)
def scene_flow(
    suite: dict[str, Any], dataset: str, scene: str, store: str, progress: bool = False
) -> list[SceneOutcome]:
    """All lines of a suite on one scene.

    A line that fails is reported as failed, and the others go on.

    Args:
        suite: The suite's configuration as JSON values.
        dataset: Name of the data set.
        scene: Name of the scene.
        store: Root of the artifact store.
        progress: Show progress bars.
    """
    config = SuiteConfig.model_validate(suite)
    choice = next(d for d in config.datasets if d.name == dataset)
    with Progress(shown=progress) as bars:
        try:
            data = load_scene(choice, scene, config.exclude_eval_views)
        except Exception as error:
            return [_failed(dataset, scene, line, error) for line in config.lines()]
        return [run_line(data, config, line, Store(store), bars) for line in config.lines()]


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


def result_rows(
    dataset: str, scene: str, method: str, queries: Sequence[Query], scored: Sequence[Scored]
) -> list[Row]:
    """Rows of a scene's evaluation with all the names that a result has them under."""
    known = {query.id: query for query in queries}
    return [
        Row(
            dataset=dataset,
            scene=scene,
            method=method,
            text=known[row["query"]].text,
            target=known[row["query"]].target,
            absent=known[row["query"]].absent,
            **row,
        )
        for row in scored
    ]


def run_line(
    data: SceneData,
    suite: SuiteConfig,
    line: Line,
    store: Store,
    progress: Progress | None = None,
) -> SceneOutcome:
    """One line on one scene, from its stages to rows and timings.

    Args:
        data: The scene.
        suite: The benchmark's configuration.
        line: The method and its models.
        store: Where results of stages lie.
        progress: Shows progress bars; None shows none.

    Returns:
        The outcome; a failure is an outcome too, with the error's text.
    """
    try:
        job = make_job(
            data,
            line.method,
            store,
            line.models,
            suite.renderer,
            suite.limit,
            progress,
            line.name,
            suite.evidence and not line.is_variant,
        )
        runs = run_stages(job)
        return _outcome(line, job, runs)
    except Exception as error:
        return _failed(data.scene.dataset, data.scene.name, line, error)


def _outcome(line: Line, job: SceneJob, runs: dict[str, StageRun]) -> SceneOutcome:
    scene = job.data.scene
    answers = unpack_answers(job.store.load_arrays(runs["segment"]["groundings"]))
    queries, pictures = [], {}
    names = (scene.dataset, scene.name, line.name)
    folder = "/".join(("pictures", *map(file_name, names)))
    for query, answer in zip(job.queries, answers, strict=True):
        path = None
        if not line.is_variant:  # dozens of nearly equal pictures of each query help nobody
            path = f"{folder}/{query.id}.png"
            pictures[path] = job.store.path(runs["evaluate"][f"picture.{query.id}"])
        queries.append(_query_outcome(query, answer, runs, path))
    evidence = None
    if "evidence" in runs["evaluate"].artifacts:
        evidence = f"{'/'.join(('evidence', *map(file_name, names)))}.json"
        pictures[evidence] = job.store.path(runs["evaluate"]["evidence"])
    scored = job.store.load_json(runs["evaluate"]["rows"])
    rows = tuple(result_rows(scene.dataset, scene.name, line.name, job.queries, scored))
    seconds = [sum(outcome.seconds.values()) for outcome in queries]
    camera = scene.views[0].camera
    result = SceneResult(
        **_identity(scene.dataset, scene.name, line),
        status="completed",
        n_gaussians=len(scene.gaussians),
        n_views=len(scene.views),
        n_patches=int(runs["masks"].record.detail["n_patches"]) if "masks" in runs else 0,
        picture_size=(camera.width, camera.height),
        models=job.model_names(),
        digests=dict(job.data.digests),
        original=job.data.original,
        prepare_seconds=sum(runs[stage].record.seconds for stage in PREPARATION if stage in runs),
        query_seconds=sum(seconds) / len(seconds) if seconds else 0.0,
        stages=tuple(_timing(run) for run in runs.values()),
        queries=tuple(queries),
        evidence=evidence,
    )
    return SceneOutcome(result, rows, pictures)


def _query_outcome(
    query: Query, answer: Answer, runs: dict[str, StageRun], picture: str | None
) -> QueryOutcome:
    locate: Any = runs["query"].record.detail["seconds"]
    segment: Any = runs["segment"].record.detail["seconds"]
    place = answer.location
    return QueryOutcome(
        query=query.id,
        found=answer.found,
        location=None if place is None else (float(place[0]), float(place[1]), float(place[2])),
        n_flagged=int(answer.flags.sum()),
        confidence=answer.confidence,
        seconds={"query": locate[query.id], "segment": segment[query.id]["segment"]},
        picture=picture,
    )


def _timing(run: StageRun) -> StageTiming:
    record = run.record
    return StageTiming(
        stage=record.stage,
        seconds=record.seconds,
        cpu_seconds=record.cpu_seconds,
        peak_bytes=record.peak_bytes,
        state="cached" if run.cached else "computed",
        key=record.key,
    )


def _identity(dataset: str, scene: str, line: Line) -> dict[str, Any]:
    """Which scene and which line a result is of."""
    return {
        "dataset": dataset,
        "scene": scene,
        "method": line.name,
        "label": line.label,
        "model_set": line.model_set,
        "reference": line.reference,
    }


def _failed(dataset: str, scene: str, line: Line, error: Exception) -> SceneOutcome:
    if not isinstance(error, GVRError):  # a mistake of ours, or a machine's: show where
        log.error("%s/%s · %s failed", dataset, scene, line.name, exc_info=error)
    text = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
    result = SceneResult(**_identity(dataset, scene, line), status="failed", error=text)
    return SceneOutcome(result, bad_input=isinstance(error, InputError))
