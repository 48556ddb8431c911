"""The seven stages of a scene: what each reads, what its cache key is made of, what it computes.

::

    render ─┬─> masks ──> encode ──> query ──> segment ──> evaluate
    depth ──┘ (also into encode and query)

A stage's key is its name and version, the digests of its inputs, and its own slice of the
configuration. Changing the queries leaves the first four stages as they are; changing the
renderer changes every picture, and so everything below.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from datasets.base import SceneData
from gvr_core import preparation
from gvr_core.books import Books, DepthBook, PatchBook, SemanticVectorBook, ViewBook
from gvr_core.methods import MethodConfig, Toolbox, build_method
from gvr_core.metrics import FLAGS_3D, IN_SCENE_2D, REFUSAL
from gvr_core.scene import Query
from tasks.evaluation import draw_query, score_query
from tasks.groundings import (
    pack_groundings,
    pack_localization,
    unpack_answers,
    unpack_localization,
)
from tasks.records import StageRecord, canonical_json
from tasks.store import StageOutput, Store

Records = Mapping[str, StageRecord]
Track = Callable[[Iterable[Any], str], Iterable[Any]]
"""Wraps a loop, e.g. in a progress bar; the text says what is being done."""


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

    def texts_digest(self) -> str:
        """sha256 of the queries as a method sees them: ids and words, no answers."""
        return _digest([[query.id, query.text] for query in self.queries])

    def queries_digest(self) -> str:
        """sha256 of the queries with their answers."""
        return _digest([query.model_dump() for query in self.queries])


@dataclass(frozen=True)
class StagePlan:
    """A stage: its name and version, its inputs, its slice of the configuration, its work."""

    name: str
    version: int
    inputs: Callable[[SceneJob, Records], dict[str, str]]
    config: Callable[[SceneJob], dict[str, Any]]
    compute: Callable[[SceneJob, Records], StageOutput]


def compute_render(job: SceneJob, done: Records) -> StageOutput:
    """Render every knowledge view."""
    scene = job.data.scene
    book = preparation.render_views(
        scene.gaussians,
        scene.views,
        job.tools.renderer,
        job.method.segment.background,
        lambda views: job.track(views, "render"),
    )
    artifact = job.store.put_arrays("view_book", book.to_arrays())
    return StageOutput({"views": artifact}, {"n_views": len(book)})


def compute_depth(job: SceneJob, done: Records) -> StageOutput:
    """Render every knowledge view's depth: the Depth Book."""
    scene = job.data.scene
    book = preparation.render_depths(
        scene.gaussians,
        scene.views,
        job.tools.renderer,
        lambda views: job.track(views, "depth"),
    )
    artifact = job.store.put_arrays("depth_book", book.to_arrays())
    return StageOutput({"depths": artifact}, {"n_views": len(book)})


def compute_masks(job: SceneJob, done: Records) -> StageOutput:
    """Cut every view into patches."""
    book = preparation.segment_views(
        _view_book(job, done),
        _depth_book(job, done),
        job.data.scene.views,
        job.tools.models.segmenter,
        lambda views: job.track(views, "masks"),
    )
    artifact = job.store.put_arrays("patch_book", book.to_arrays())
    return StageOutput({"patches": artifact}, {"n_patches": len(book)})


def compute_encode(job: SceneJob, done: Records) -> StageOutput:
    """Encode every patch: the Semantic Vector Book."""
    book = preparation.encode_patches(
        _view_book(job, done),
        _depth_book(job, done),
        job.data.scene.views,
        _patch_book(job, done),
        job.tools.models.encoder,
        lambda views: job.track(views, "encode"),
    )
    artifact = job.store.put_arrays("semantic_vectors", {"features": book.features})
    return StageOutput({"features": artifact}, {"c": int(book.features.shape[1])})


def compute_query(job: SceneJob, done: Records) -> StageOutput:
    """RFL: localise every query."""
    method = build_method(job.method, job.tools)
    features = job.store.load_arrays(done["encode"].artifacts["features"])["features"]
    semantics = SemanticVectorBook(features, _patch_book(job, done))
    books = Books(_view_book(job, done), _depth_book(job, done), semantics)
    places, seconds = {}, {}
    for query in job.track(job.queries, "query"):
        start = time.perf_counter()
        places[query.id] = pack_localization(method.locate(job.data.scene, books, query))
        seconds[query.id] = time.perf_counter() - start
    artifact = job.store.put_json("localizations", places)
    return StageOutput({"localizations": artifact}, {"seconds": seconds})


def compute_segment(job: SceneJob, done: Records) -> StageOutput:
    """Segment every query's target, given where it is."""
    method = build_method(job.method, job.tools)
    places = job.store.load_json(done["query"].artifacts["localizations"])
    groundings, seconds = [], {}
    for query in job.track(job.queries, "segment"):
        start = time.perf_counter()
        place = unpack_localization(places[query.id])
        grounding = method.segment(job.data.scene, place, query)
        seconds[query.id] = grounding.seconds | {"segment": time.perf_counter() - start}
        groundings.append(grounding)
    arrays = pack_groundings(groundings, len(job.data.scene.gaussians))
    artifact = job.store.put_arrays("groundings", arrays)
    return StageOutput({"groundings": artifact}, {"seconds": seconds})


def compute_evaluate(job: SceneJob, done: Records) -> StageOutput:
    """Score every query, and draw it."""
    answers = unpack_answers(job.store.load_arrays(done["segment"].artifacts["groundings"]))
    rows, artifacts, unseen = [], {}, 0
    for query, answer in job.track(list(zip(job.queries, answers, strict=True)), "evaluate"):
        scored, hidden = score_query(job.data, query, answer, job.tools.renderer)
        picture = draw_query(job.data, query, answer, scored, job.tools.renderer)
        artifacts[f"picture.{query.id}"] = job.store.put_bytes("picture", picture, ".png")
        rows += scored
        unseen += hidden
    artifacts["rows"] = job.store.put_json("rows", rows)
    return StageOutput(artifacts, {"views_without_object": unseen})


def _scene_inputs(job: SceneJob, *parts: str) -> dict[str, str]:
    return {part: job.data.digests[part] for part in parts}


def _digests(done: Records, *stages: str) -> dict[str, str]:
    return {stage: done[stage].digest for stage in stages}


STAGES = (
    StagePlan(
        "render",
        1,
        lambda job, done: _scene_inputs(job, "gaussians", "views"),
        lambda job: {
            "renderer": job.tools.renderer.name,
            "background": list(job.method.segment.background),
        },
        compute_render,
    ),
    StagePlan(
        "depth",
        1,
        lambda job, done: _scene_inputs(job, "gaussians", "views"),
        lambda job: {"renderer": job.tools.renderer.name},
        compute_depth,
    ),
    StagePlan(
        "masks",
        1,
        lambda job, done: _scene_inputs(job, "views") | _digests(done, "render", "depth"),
        lambda job: {"segmenter": job.tools.models.segmenter.name},
        compute_masks,
    ),
    StagePlan(
        "encode",
        1,
        lambda job, done: _scene_inputs(job, "views") | _digests(done, "render", "depth", "masks"),
        lambda job: {"encoder": job.tools.models.encoder.name},
        compute_encode,
    ),
    StagePlan(
        "query",
        1,
        lambda job, done: (
            _scene_inputs(job, "views")
            | _digests(done, "depth", "masks", "encode")
            | {"texts": job.texts_digest()}
        ),
        lambda job: {
            "method": job.method.method,
            "encoder": job.tools.models.encoder.name,
            "locate": job.method.locate.model_dump(mode="json"),
        },
        compute_query,
    ),
    StagePlan(
        "segment",
        1,
        lambda job, done: (
            _scene_inputs(job, "gaussians", "views")
            | _digests(done, "query")
            | {"texts": job.texts_digest()}
        ),
        lambda job: {
            "method": job.method.method,
            "renderer": job.tools.renderer.name,
            "segmenter": job.tools.models.segmenter.name,
            "text_segmenter": job.tools.models.text_segmenter.name,
            "rfl": job.method.locate.rfl,
            "segment": job.method.segment.model_dump(mode="json"),
        },
        compute_segment,
    ),
    StagePlan(
        "evaluate",
        1,
        lambda job, done: (
            _scene_inputs(job, "gaussians", "truth")
            | _digests(done, "segment")
            | {"queries": job.queries_digest()}
        ),
        lambda job: {
            "renderer": job.tools.renderer.name,
            "protocols": [IN_SCENE_2D, FLAGS_3D, REFUSAL],
        },
        compute_evaluate,
    ),
)
"""The stages, in the order in which they run."""

PREPARATION = ("render", "depth", "masks", "encode")
"""Stages before any query: the paper's preparation time."""


def _view_book(job: SceneJob, done: Records) -> ViewBook:
    return ViewBook.from_arrays(job.store.load_arrays(done["render"].artifacts["views"]))


def _depth_book(job: SceneJob, done: Records) -> DepthBook:
    return DepthBook.from_arrays(job.store.load_arrays(done["depth"].artifacts["depths"]))


def _patch_book(job: SceneJob, done: Records) -> PatchBook:
    return PatchBook.from_arrays(job.store.load_arrays(done["masks"].artifacts["patches"]))


def _digest(value: object) -> str:
    return hashlib.sha256(canonical_json(value)).hexdigest()
