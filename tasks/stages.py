"""The eight stages of a scene: what each reads, and what its cache key is made of.

::

    render ──> depth ──> masks ──> encode ──> index ──> query ──> segment ──> evaluate
                         (query and segment see all the books)

A stage's key is its name and version, the digests of its inputs, and its own slice of the
configuration; :data:`STAGES` shows all of them at a glance. Changing the queries leaves the first
five stages as they are; changing the renderer changes every picture, and so everything below.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from gvr_core.books import Books
from tasks.computing import (
    Inputs,
    compute_depth,
    compute_encode,
    compute_evaluate,
    compute_index,
    compute_masks,
    compute_query,
    compute_render,
    compute_segment,
)
from tasks.open_books import NO_BOOKS, OpenBooks
from tasks.records import StageRecord
from tasks.scene_job import SceneJob
from tasks.stage import Stage, StageRun, run_stage

T = TypeVar("T")


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
