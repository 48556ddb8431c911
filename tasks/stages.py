"""The eight stages of a scene: what each reads, what its cache key is made of, what it computes.

::

    render ──> depth ──> masks ──> encode ──> index ──> query ──> segment ──> evaluate
                         (query and segment see all the books)

One rendering pass makes both the View Book and the Depth Book; ``depth`` hands the latter on. Books
are written view by view and read by memory map, so that no stage holds all views at once.

A stage's key is its name and version, the digests of its inputs, and its own slice of the
configuration; :data:`STAGES` shows all of them at a glance. Changing the queries leaves the first
five stages as they are; changing the renderer changes every picture, and so everything below.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from datasets.base import SceneData
from gvr_core import preparation
from gvr_core.books import Books
from gvr_core.errors import StoreError
from gvr_core.methods import MethodConfig, Toolbox, build_method
from gvr_core.robust.calibration import calibration_of
from gvr_core.scene import Query
from tasks.arrays import StoredArrays
from tasks.drawing import draw_query
from tasks.evaluation import score_scene
from tasks.evidence import gather_evidence
from tasks.groundings import (
    pack_groundings,
    pack_localization,
    small_pictures,
    unpack_answers,
    unpack_localization,
    without_pictures,
)
from tasks.open_books import NO_BOOKS, OpenBooks
from tasks.query_times import QueryTimes
from tasks.records import StageRecord
from tasks.stage import Stage, StageRun, run_stage
from tasks.store import StageOutput, Store, canonical_json

T = TypeVar("T")

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
    evidence: bool = False
    """Whether the steps behind each answer are kept as small pictures."""

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
            "evidence": self.evidence,
        }

    def digests(self) -> dict[str, str]:
        """sha256 of each part of the scene, and of the queries without and with their answers."""
        texts = [[query.id, query.text] for query in self.queries]
        answers = [query.model_dump() for query in self.queries]
        return {**self.data.digests, "texts": _digest(texts), "queries": _digest(answers)}


def compute_render(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """Render every knowledge view once: the View Book, and the Depth Book for the next stage."""
    scene = job.data.scene
    sizes = preparation.view_sizes(scene.views)
    pixels = _n_pixels(sizes)
    pictures = preparation.render_each(
        scene.gaussians,
        scene.views,
        job.tools.renderer,
        job.method.background,
        lambda views: job.track(views, "render"),
    )
    view_layout = {"values": ("u1", (pixels, 3)), "alphas": ("u1", (pixels,))}
    depth_layout = {"expected": ("f4", (pixels,)), "median": ("f4", (pixels,))}
    of_sizes = {"sizes": ("i4", sizes.shape)}
    with (
        store.new_arrays("view_book", view_layout | of_sizes) as views,
        store.new_arrays("depth_book", depth_layout | of_sizes) as depths,
    ):
        views.append("sizes", sizes)
        depths.append("sizes", sizes)
        for picture in pictures:
            views.append("values", picture.values)
            views.append("alphas", picture.alphas)
            depths.append("expected", picture.expected)
            depths.append("median", picture.median)
    artifacts = {"views": views.artifact, "depths": depths.artifact}
    return StageOutput(artifacts, {"n_views": len(sizes)})


def compute_depth(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """The Depth Book: what the render stage has drawn of it, if it is one of these views.

    Raises:
        StoreError: It is not.
    """
    artifact = inputs["render"]["depths"]
    sizes = preparation.view_sizes(job.data.scene.views)
    pixels = _n_pixels(sizes)
    # Of its content, that the render stage or its look-up has just checked, the header is read.
    book = StoredArrays(store.locate(artifact))
    found = {name: book.shape(name) for name in book}
    expected = {"expected": (pixels,), "median": (pixels,), "sizes": sizes.shape}
    if found != expected or not np.array_equal(book["sizes"], sizes):
        raise StoreError(
            f"depth book {artifact.path} holds {found} (accepted: {expected}, the cameras' sizes)"
        )
    return StageOutput({"depths": artifact}, {"n_views": len(sizes)})


def compute_masks(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """Cut every view into patches."""
    opened = OpenBooks(store, inputs)
    book = preparation.segment_views(
        opened.views,
        opened.depths,
        job.data.scene.views,
        job.tools.models.segmenter,
        lambda views: opened.let_go_after_each(job.track(views, "masks")),
    )
    artifact = store.put_arrays("patch_book", book.to_arrays())
    return StageOutput({"patches": artifact}, {"n_patches": len(book)})


def compute_encode(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """Encode every patch: the Semantic Vector Book."""
    opened = OpenBooks(store, inputs)
    book = preparation.encode_patches(
        opened.views,
        opened.depths,
        job.data.scene.views,
        opened.patches,
        job.tools.models.encoder,
        lambda views: opened.let_go_after_each(job.track(views, "encode")),
    )
    artifact = store.put_arrays("semantic_vectors", {"features": book.features})
    return StageOutput({"features": artifact}, {"c": int(book.features.shape[1])})


def compute_index(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """The method's own part of the preparation; the paper's has none."""
    method = build_method(job.method, job.tools)
    arrays = method.index(job.data.scene, OpenBooks(store, inputs).all)
    return StageOutput({"index": store.put_arrays("index", arrays)}, {"arrays": sorted(arrays)})


def compute_query(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """RFL: localise every query."""
    method, scene = build_method(job.method, job.tools), job.data.scene
    opened = OpenBooks(store, inputs)
    books = opened.all
    shared = method.share(scene, books, job.queries)
    places, times = {}, QueryTimes(shared)
    for query in opened.let_go_after_each(job.track(job.queries, "query")):
        place = times.time(query.id, partial(method.locate, scene, books, query, shared))
        places[query.id] = pack_localization(place)
    artifact = store.put_json("localizations", places)
    detail = {"seconds": times.seconds, "shared_seconds_each": times.shared_each}
    return StageOutput({"localizations": artifact}, detail)


def compute_segment(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """Segment every query's target, given where it is."""
    method, scene = build_method(job.method, job.tools), job.data.scene
    opened = OpenBooks(store, inputs)
    books = opened.all
    places = store.load_json(inputs["query"]["localizations"])
    shared = method.share(scene, books, job.queries)
    groundings, pictures, times = [], [], QueryTimes(shared)
    for query in opened.let_go_after_each(job.track(job.queries, "segment")):
        place = unpack_localization(places[query.id])
        segment = partial(method.segment, scene, books, place, query, shared)
        grounding = times.time(query.id, segment)
        pictures.append(small_pictures(grounding))
        groundings.append(without_pictures(grounding))
    seconds = {
        query: grounding.seconds | {"segment": own}
        for grounding, (query, own) in zip(groundings, times.seconds.items(), strict=True)
    }
    arrays = pack_groundings(groundings, len(scene.gaussians), pictures)
    artifact = store.put_arrays("groundings", arrays)
    detail = {"seconds": seconds, "shared_seconds_each": times.shared_each}
    return StageOutput({"groundings": artifact}, detail)


def compute_evaluate(store: Store, inputs: Inputs, config: Config, job: SceneJob) -> StageOutput:
    """Score every query, draw it, and gather the evidence for it."""
    answers = unpack_answers(store.load_arrays(inputs["segment"]["groundings"]))
    scores = score_scene(job.data, job.queries, answers, job.tools.renderer)
    artifacts = {"rows": store.put_json("rows", scores.rows)}
    for query, answer in job.track(list(zip(job.queries, answers, strict=True)), "evaluate"):
        own = [row for row in scores.rows if row["query"] == query.id]
        picture = draw_query(job.data, query, answer, own, job.tools.renderer)
        artifacts[f"picture.{query.id}"] = store.put_bytes("picture", picture, ".png")
    if config["evidence"]:
        has_books = inputs["render"] != NO_BOOKS
        opened = OpenBooks(store, inputs)
        evidence = gather_evidence(
            job.data,
            job.queries,
            store.load_arrays(inputs["segment"]["groundings"]),
            store.load_json(inputs["query"]["localizations"]),
            opened.views if has_books else None,
            opened.patches if has_books else None,
            job.tools.renderer,
        )
        content = evidence.model_dump_json().encode()
        artifacts["evidence"] = store.put_bytes("evidence", content, ".json")
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
        Stage("render", 2, compute_render, ("renderer", "background")),
        ("gaussians", "views"),
    ),
    PlannedStage(
        Stage("depth", 2, compute_depth),
        ("views", "render"),
    ),
    PlannedStage(
        Stage("masks", 1, compute_masks, ("segmenter",)),
        ("views", "render", "depth"),
    ),
    PlannedStage(
        Stage("encode", 2, compute_encode, ("encoder",)),
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
        Stage("evaluate", 4, compute_evaluate, ("renderer", "protocols", "evidence")),
        ("gaussians", "views", "queries", "truth", "render", "masks", "query", "segment"),
    ),
)
"""The stages, in the order in which they run."""

PREPARATION = ("render", "depth", "masks", "encode", "index")
"""Stages before any query: the paper's preparation time."""


def run_stages(job: SceneJob, last: str = STAGES[-1].stage.name) -> dict[str, StageRun]:
    """Run the stages of a job, or find their results in the store.

    Args:
        job: One method on one scene.
        last: The stage to end with.

    Returns:
        Stage name -> how it ended; without the preparation's stages for methods that need no
        books.
    """
    config = job.config()

    def run(stage: Stage, inputs: Inputs) -> StageRun:
        return run_stage(stage, job.store, inputs, config, label=job.label, runtime={"job": job})

    return _through_stages(job, run, last)


def stages_in_store(job: SceneJob) -> dict[str, bool]:
    """Which stages of a job are in the store; nothing is computed.

    Args:
        job: One method on one scene.

    Returns:
        Stage name -> whether its result is there. What builds on a stage that is not there has
        no key yet, and is not there either.
    """
    config = job.config()

    def look_up(stage: Stage, inputs: Inputs) -> StageRecord | None:
        if None in inputs.values():
            return None
        return job.store.lookup(stage.name, stage.key(inputs, config))

    found = _through_stages(job, look_up, STAGES[-1].stage.name)
    return {name: record is not None for name, record in found.items()}


def prepared_books(job: SceneJob) -> Books:
    """Run the stages before any query, or find their results in the store.

    Args:
        job: One method on one scene, of a method that needs books; its queries play no part.

    Returns:
        What the preparation knows of the scene.
    """
    return OpenBooks(job.store, run_stages(job, PREPARATION[-1])).all


def _through_stages(job: SceneJob, step: Callable[[Stage, Inputs], T], last: str) -> dict[str, T]:
    """What a step gives for each stage in turn, whose inputs are what it gave for others."""
    known: dict[str, Any] = job.digests()
    given: dict[str, T] = {}
    for planned in STAGES:
        name = planned.stage.name
        if name in PREPARATION and not job.method.needs_books:
            known[name] = NO_BOOKS
            continue
        known[name] = given[name] = step(
            planned.stage, {part: known[part] for part in planned.inputs}
        )
        if name == last:
            break
    return given


def _n_pixels(sizes: NDArray[np.int32]) -> int:
    """P: pixels of all views together."""
    return int(sizes.prod(axis=1, dtype=np.int64).sum())


def _digest(value: object) -> str:
    return hashlib.sha256(canonical_json(value)).hexdigest()
