"""A result as a document: what ``gvr run``, ``score`` and ``show`` print with ``--json``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from reports.aggregate import Aggregate, aggregate
from reports.headline import (
    Cell,
    Column,
    dataset_names,
    headings,
    method_names,
    overall_cell,
    scene_cell,
    scene_names,
)
from reports.record import QueryOutcome, Result, Row


@dataclass(frozen=True)
class SceneSummary:
    """One method on one scene."""

    dataset: str
    scene: str
    method: str
    status: Literal["completed", "failed"]
    error: str | None
    n_gaussians: int
    n_views: int
    prepare_seconds: float
    query_seconds: float
    """Mean over its queries."""
    peak_bytes: int
    stages: dict[str, str]
    """Stage -> ``computed``, ``cached``, ``fetched``, or with what was damaged."""
    answers: tuple[QueryOutcome, ...]


@dataclass(frozen=True)
class Number:
    """A headline number."""

    dataset: str
    scene: str | None
    """None for the mean over scenes."""
    method: str
    protocol: str
    metric: str
    title: str
    value: float
    """Between 0 and 1."""
    n: int
    """(query, view) pairs that it is the mean of."""
    n_expected: int
    partial: bool
    """Not over all pairs, or not over all scenes."""


@dataclass(frozen=True)
class ResultDocument:
    """A result, short: all of it is in its folder."""

    result: Path
    """Its folder."""
    run_id: str
    suite: str
    created: str
    wall_seconds: float
    status: Literal["completed", "failed"]
    """``failed`` where a scene failed."""
    numbers: tuple[Number, ...]
    """The tables' headline; none where nothing could be scored."""
    scenes: tuple[SceneSummary, ...]
    mlflow: str | None = None
    """What was written into MLflow, in words; null where nothing was."""


def result_document(
    folder: Path, result: Result, rows: Sequence[Row], mlflow: str | None = None
) -> ResultDocument:
    """A result as a document.

    Args:
        folder: The result's folder.
        result: The result.
        rows: Its rows.
        mlflow: What was written into MLflow.
    """
    scenes = tuple(
        SceneSummary(
            dataset=scene.dataset,
            scene=scene.scene,
            method=scene.method,
            status=scene.status,
            error=scene.error,
            n_gaussians=scene.n_gaussians,
            n_views=scene.n_views,
            prepare_seconds=scene.prepare_seconds,
            query_seconds=scene.query_seconds,
            peak_bytes=scene.peak_bytes,
            stages={timing.stage: timing.shown_state for timing in scene.stages},
            answers=scene.queries,
        )
        for scene in result.scenes
    )
    return ResultDocument(
        result=folder,
        run_id=result.run_id,
        suite=result.suite,
        created=result.created,
        wall_seconds=result.wall_seconds,
        status="failed" if any(s.status == "failed" for s in scenes) else "completed",
        numbers=tuple(_numbers(result, aggregate(rows, result.scenes))),
        scenes=scenes,
        mlflow=mlflow,
    )


def _numbers(result: Result, summary: Aggregate) -> Iterator[Number]:
    for dataset in dataset_names(result):
        for column in (c for columns in headings(summary, dataset) for c in columns):
            for method in method_names(result, dataset):
                for scene in (*scene_names(result, dataset), None):
                    cell = (
                        overall_cell(result, summary, dataset, method, column)
                        if scene is None
                        else scene_cell(result, summary, dataset, scene, method, column)
                    )
                    if cell.state == "value":
                        yield _number(dataset, scene, method, column, cell)


def _number(dataset: str, scene: str | None, method: str, column: Column, cell: Cell) -> Number:
    return Number(
        dataset=dataset,
        scene=scene,
        method=method,
        protocol=column.protocol,
        metric=column.metric,
        title=column.title,
        value=cell.value,
        n=cell.n,
        n_expected=cell.n_expected,
        partial=cell.partial,
    )
