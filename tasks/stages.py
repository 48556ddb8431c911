"""The eight stages of a scene: what each reads, what its cache key is made of, what it computes.

::

    render ─┬─> masks ──> encode ──> index ──> query ──> segment ──> evaluate
    depth ──┘             (query and segment see all the books)

A stage's key is its name and version, the digests of its inputs, and its own slice of the
configuration; :data:`STAGES` shows all of them at a glance. Changing the queries leaves the first
five stages as they are; changing the renderer changes every picture, and so everything below.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from datasets.base import SceneData
from gvr_core import preparation
from gvr_core.books import Books, DepthBook, PatchBook, SemanticVectorBook, ViewBook
from gvr_core.methods import MethodConfig, Toolbox, build_method
from gvr_core.robust.calibration import calibration_of
from gvr_core.scene import Query
from tasks.drawing import draw_query
from tasks.evaluation import score_scene
from tasks.groundings import (
    pack_groundings,
    pack_localization,
    unpack_answers,
    unpack_localization,
)
from tasks.query_times import QueryTimes
from tasks.stage import Stage, StageRun, run_stage
from tasks.store import StageOutput, Store, canonical_json

Track = Callable[[Iterable[Any], str], Iterable[Any]]
"""Wraps a loop, e.g. in a progress bar; the text says what is being done."""

Inputs = Mapping[str, Any]
"""Name -> the digest of a part of the scene, or how an earlier stage ended (a StageRun)."""

Config = Mapping[str, Any]
"""A stage's own slice of the configuration."""


def _untracked(items: Iterable[Any], text: str) -> Iterable[Any]:
    return items


@dataclass(frozen=True, eq=False)
class SceneJob:
    """One method on one scene: everything that its stages need."""

    store: Store
    data: SceneData
    queries: Sequence[Query]
    method: MethodConfig
    tools: Toolbox
    track: Track = field(default=_untracked)

    @property
    def label(self) -> str:
        """Data set and scene, for the names of task runs."""
        return f"{self.data.scene.dataset}/{self.data.scene.name}"

    def model_names(self) -> dict[str, str]:
        """Renderer and models, each with version, settings and digests of its weights.

        No models for a method that looks at no picture.
        """
        models = self.tools.models
        if not self.method.needs_books:
            return {"renderer": self.tools.renderer.name}
        return {
            "renderer": self.tools.renderer.name,
            "segmenter": models.segmenter.name,
            "encoder": models.encoder.name,
            "text_segmenter": models.text_segmenter.name,
        }

    def config(self) -> dict[str, Any]:
        """The whole configuration that results depend on, as JSON values."""
        none = dict.fromkeys(("segmenter", "encoder", "text_segmenter"), "none")
        names = none | self.model_names()
        return {
            "method": self.method.method,
            **self.method.settings(),
            **names,
            "calibration": calibration_of(names["encoder"]).model_dump(mode="json"),
            "protocols": list(self.data.protocols),
        }

    def digests(self) -> dict[str, str]:
        """sha256 of each part of the scene, and of the queries without and with their answers."""
        texts = [[query.id, query.text] for query in self.queries]
        answers = [query.model_dump() for query in self.queries]
        return {**self.data.digests, "texts": _digest(texts), "queries": _digest(answers)}


def compute_render(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """Render every knowledge view."""
    scene = job.data.scene
    book = preparation.render_views(
        scene.gaussians,
        scene.views,
        job.tools.renderer,
        job.method.background,
        lambda views: job.track(views, "render"),
    )
    artifact = store.put_arrays("view_book", book.to_arrays())
    return StageOutput({"views": artifact}, {"n_views": len(book)})


def compute_depth(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """Render every knowledge view's depth: the Depth Book."""
    scene = job.data.scene
    book = preparation.render_depths(
        scene.gaussians,
        scene.views,
        job.tools.renderer,
        lambda views: job.track(views, "depth"),
    )
    artifact = store.put_arrays("depth_book", book.to_arrays())
    return StageOutput({"depths": artifact}, {"n_views": len(book)})


def compute_masks(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """Cut every view into patches."""
    book = preparation.segment_views(
        _view_book(store, inputs),
        _depth_book(store, inputs),
        job.data.scene.views,
        job.tools.models.segmenter,
        lambda views: job.track(views, "masks"),
    )
    artifact = store.put_arrays("patch_book", book.to_arrays())
    return StageOutput({"patches": artifact}, {"n_patches": len(book)})


def compute_encode(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """Encode every patch: the Semantic Vector Book."""
    book = preparation.encode_patches(
        _view_book(store, inputs),
        _depth_book(store, inputs),
        job.data.scene.views,
        _patch_book(store, inputs),
        job.tools.models.encoder,
        lambda views: job.track(views, "encode"),
    )
    artifact = store.put_arrays("semantic_vectors", {"features": book.features})
    return StageOutput({"features": artifact}, {"c": int(book.features.shape[1])})


def compute_index(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """The method's own part of the preparation; the paper's has none."""
    method = build_method(job.method, job.tools)
    arrays = method.index(job.data.scene, _books(store, inputs))
    return StageOutput({"index": store.put_arrays("index", arrays)}, {"arrays": sorted(arrays)})


def compute_query(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """RFL: localise every query."""
    method, scene = build_method(job.method, job.tools), job.data.scene
    books = _books(store, inputs)
    shared = method.share(scene, books, job.queries)
    places, times = {}, QueryTimes(shared)
    for query in job.track(job.queries, "query"):
        place = times.time(query.id, partial(method.locate, scene, books, query, shared))
        places[query.id] = pack_localization(place)
    artifact = store.put_json("localizations", places)
    detail = {"seconds": times.seconds, "shared_seconds_each": times.shared_each}
    return StageOutput({"localizations": artifact}, detail)


def compute_segment(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """Segment every query's target, given where it is."""
    method, scene = build_method(job.method, job.tools), job.data.scene
    books = _books(store, inputs)
    places = store.load_json(inputs["query"]["localizations"])
    shared = method.share(scene, books, job.queries)
    groundings, times = [], QueryTimes(shared)
    for query in job.track(job.queries, "segment"):
        place = unpack_localization(places[query.id])
        segment = partial(method.segment, scene, books, place, query, shared)
        groundings.append(times.time(query.id, segment))
    seconds = {
        query: grounding.seconds | {"segment": own}
        for grounding, (query, own) in zip(groundings, times.seconds.items(), strict=True)
    }
    arrays = pack_groundings(groundings, len(scene.gaussians))
    artifact = store.put_arrays("groundings", arrays)
    detail = {"seconds": seconds, "shared_seconds_each": times.shared_each}
    return StageOutput({"groundings": artifact}, detail)


def compute_evaluate(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """Score every query, and draw it."""
    answers = unpack_answers(store.load_arrays(inputs["segment"]["groundings"]))
    scores = score_scene(job.data, job.queries, answers, job.tools.renderer)
    artifacts = {"rows": store.put_json("rows", scores.rows)}
    for query, answer in job.track(list(zip(job.queries, answers, strict=True)), "evaluate"):
        own = [row for row in scores.rows if row["query"] == query.id]
        picture = draw_query(job.data, query, answer, own, job.tools.renderer)
        artifacts[f"picture.{query.id}"] = store.put_bytes("picture", picture, ".png")
    left_out = {"unlabelled": scores.unlabelled, "left_out": scores.left_out}
    return StageOutput(artifacts, left_out)


@dataclass(frozen=True)
class PlannedStage:
    """A stage, and which digests are its inputs."""

    stage: Stage
    inputs: tuple[str, ...]
    """Parts of the scene, ``texts`` or ``queries``, and names of earlier stages."""


STAGES = (
    PlannedStage(
        Stage("render", 1, compute_render, ("renderer", "background")),
        ("gaussians", "views"),
    ),
    PlannedStage(
        Stage("depth", 1, compute_depth, ("renderer",)),
        ("gaussians", "views"),
    ),
    PlannedStage(
        Stage("masks", 1, compute_masks, ("segmenter",)),
        ("views", "render", "depth"),
    ),
    PlannedStage(
        Stage("encode", 1, compute_encode, ("encoder",)),
        ("views", "render", "depth", "masks"),
    ),
    PlannedStage(
        Stage("index", 3, compute_index, ("method", "renderer", "index")),
        ("gaussians", "views", "render", "depth", "masks", "encode"),
    ),
    PlannedStage(
        Stage("query", 4, compute_query, ("method", "encoder", "calibration", "locate")),
        ("gaussians", "views", "texts", "render", "depth", "masks", "encode", "index"),
    ),
    PlannedStage(
        Stage(
            "segment",
            4,
            compute_segment,
            (
                "method",
                "renderer",
                "segmenter",
                "encoder",
                "calibration",
                "text_segmenter",
                "background",
                "segment",
            ),
        ),
        ("gaussians", "views", "texts", "render", "depth", "masks", "encode", "index", "query"),
    ),
    PlannedStage(
        Stage("evaluate", 3, compute_evaluate, ("renderer", "protocols")),
        ("gaussians", "views", "queries", "truth", "segment"),
    ),
)
"""The stages, in the order in which they run."""

NO_BOOKS = hashlib.sha256(b"no books").hexdigest()
"""Stands for the results of the preparation where a method needs none."""

PREPARATION = ("render", "depth", "masks", "encode", "index")
"""Stages before any query: the paper's preparation time."""


def run_stages(job: SceneJob) -> dict[str, StageRun]:
    """Run every stage of a job, or find its result in the store.

    Args:
        job: One method on one scene.

    Returns:
        Stage name -> how it ended; without the preparation's stages for methods that need no
        books.
    """
    known: dict[str, Any] = job.digests()
    config = job.config()
    runs: dict[str, StageRun] = {}
    for planned in STAGES:
        if planned.stage.name in PREPARATION and not job.method.needs_books:
            known[planned.stage.name] = NO_BOOKS
            continue
        inputs = {name: known[name] for name in planned.inputs}
        run = run_stage(
            planned.stage, job.store, inputs, config, label=job.label, runtime={"job": job}
        )
        known[planned.stage.name] = runs[planned.stage.name] = run
    return runs


def _view_book(store: Store, inputs: Inputs) -> ViewBook:
    return ViewBook.from_arrays(store.load_arrays(inputs["render"]["views"]))


def _depth_book(store: Store, inputs: Inputs) -> DepthBook:
    return DepthBook.from_arrays(store.load_arrays(inputs["depth"]["depths"]))


def _patch_book(store: Store, inputs: Inputs) -> PatchBook:
    return PatchBook.from_arrays(store.load_arrays(inputs["masks"]["patches"]))


def _books(store: Store, inputs: Inputs) -> Books:
    """All the books that the earlier stages have made."""
    if inputs["encode"] == NO_BOOKS:
        return Books.none()
    features = store.load_arrays(inputs["encode"]["features"])["features"]
    semantics = SemanticVectorBook(features, _patch_book(store, inputs))
    index = store.load_arrays(inputs["index"]["index"]) if "index" in inputs else {}
    return Books(_view_book(store, inputs), _depth_book(store, inputs), semantics, index)


def _digest(value: object) -> str:
    return hashlib.sha256(canonical_json(value)).hexdigest()
