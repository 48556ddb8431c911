"""The MLflow run of one method on one scene.

What one query scored is called ``query/...``; its step is the query's place in the scene.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from reports.aggregate import Aggregate
from reports.headline import HEADLINE
from reports.mlflow_run import (
    InputData,
    Point,
    RunContent,
    as_table,
    common_tags,
    finite,
    flatten,
    is_class_mean,
    is_main,
    metric_name,
    safe_items,
    safe_key,
    shown_datasets,
)
from reports.record import QueryOutcome, Result, Row, SceneResult

MAX_DATASET_NAME = 500
"""MLflow's limit."""


def scene_content(
    folder: Path, result: Result, item: SceneResult, rows: Sequence[Row], summary: Aggregate
) -> RunContent:
    """What the run of one method on one scene holds.

    Args:
        folder: The result's folder.
        result: The benchmark.
        item: The scene and method.
        rows: Their rows.
        summary: The averages of all rows.
    """
    width, height = item.picture_size
    tags = {
        "kind": "scene",
        "dataset": item.dataset,
        "scene": item.scene,
        **_line_names(item),
        "models": ", ".join(dict.fromkeys(item.models.values())) or "none",
        "protocols": ", ".join(dict.fromkeys(row.protocol for row in rows)) or "none",
        "status": item.status,
        **({"peak_memory_is_own": json.dumps(item.peak_is_own)} if item.stages else {}),
        **({"error": item.error} if item.error else {}),
        **common_tags(result),  # last: MLflow shows tags in this order, and these are many
    }
    params = {
        "dataset": item.dataset,
        "scene": item.scene,
        **_line_names(item),
        **{f"model.{role}": name for role, name in item.models.items()},
        "n_views": item.n_views,
        "n_gaussians": item.n_gaussians,
        "n_patches": item.n_patches,
        "resolution": f"{width}x{height}",
        **{f"digest.{part}": value for part, value in item.digests.items()},
        **dict(flatten(result.config, "config")),
    }
    table = [_query_line(query, rows) for query in item.queries]
    points, n_left_out = finite([*_scene_points(item, summary), *_query_points(item, table)])
    return RunContent(
        name=f"{item.scene} · {item.method}",
        failed=item.status == "failed",
        seconds=item.prepare_seconds + sum(sum(q.seconds.values()) for q in item.queries),
        tags=safe_items(tags),
        params=safe_items(params),
        points=points,
        n_left_out=n_left_out,
        files=tuple(
            (folder / q.picture, str(Path(q.picture).parent)) for q in item.queries if q.picture
        ),
        tables={"queries.json": as_table(table)} if table else {},
        datasets=inputs(result, item),
    )


def inputs(result: Result, item: SceneResult) -> tuple[InputData, ...]:
    """The scene as the data that a run was given; nothing where it failed before it was read."""
    if not item.digests:
        return ()
    name = shown_datasets(result)[item.dataset]
    digest = hashlib.sha256(json.dumps(item.digests, sort_keys=True).encode()).hexdigest()
    tags = {
        "dataset": name,
        "scene": item.scene,
        **{f"digest.{part}": value for part, value in item.digests.items()},
    }
    profile = {"n_gaussians": item.n_gaussians, "n_views": item.n_views}
    return (
        InputData(
            name=f"{name}/{item.scene}"[:MAX_DATASET_NAME],
            digest=digest[:8],
            source=json.dumps({"tags": tags}),
            profile=json.dumps(profile),
        ),
    )


def _line_names(item: SceneResult) -> dict[str, str]:
    """The line's name and its parts; a part that it does not have is left out."""
    names = {
        "method": item.method,
        "label": item.shown_label,
        "model_set": item.model_set,
        "reference": item.reference or "",
    }
    return {key: name for key, name in names.items() if name}


def _scene_points(item: SceneResult, summary: Aggregate) -> Iterator[Point]:
    """The scene's numbers; MLflow's table shows them in this order."""
    parts = [
        part
        for part in summary.scenes
        if (part.dataset, part.scene, part.method) == (item.dataset, item.scene, item.method)
    ]
    for column in HEADLINE:
        for part in parts:
            if column.protocol == part.protocol and column.metric in part.metrics:
                yield Point(column.key, part.metrics[column.metric].mean)
    yield Point("n_queries", len(item.queries))
    if item.status != "failed":
        yield from _cost_points(item)
    for part in parts:
        for metric, mean in part.metrics.items():
            name = metric_name(part.protocol, metric)
            # The protocol's own mean first; the others beside it under names of their own.
            yield Point(name, mean.class_macro if is_class_mean(part.protocol) else mean.mean)
            if mean.n_undefined:
                yield Point(safe_key(f"{name}_undefined"), mean.n_undefined)
            if is_main(part.protocol, metric):
                yield Point(safe_key(f"{name}_flat"), mean.mean)
                yield Point(safe_key(f"{name}_class_macro"), mean.class_macro)
                yield Point(safe_key(f"{name}_coverage"), mean.coverage)
        yield Point(metric_name(part.protocol, "n_rows"), part.n_rows)
        if part.n_absent:
            yield Point(metric_name(part.protocol, "n_absent"), part.n_absent)
    refusal = summary.refusal(item.dataset, item.scene, item.method)
    if refusal is not None:
        yield Point("n_absent_queries", refusal.n_absent)
        yield Point("n_absent_refused", refusal.n_refused)
        yield Point("n_present_refused", refusal.n_present_refused)
    if item.status != "failed":
        yield from _stage_points(item)


def _cost_points(item: SceneResult) -> Iterator[Point]:
    yield Point("prepare_seconds", item.prepare_seconds)
    if item.queries:
        yield Point("query_seconds", item.query_seconds)
        yield Point("found", sum(query.found for query in item.queries) / len(item.queries))
    if item.stages:
        yield Point("peak_memory_mb", item.peak_bytes / 1e6)


def _stage_points(item: SceneResult) -> Iterator[Point]:
    for stage in item.stages:
        name = safe_key(stage.stage)
        yield Point(f"stage_seconds/{name}", stage.seconds)
        yield Point(f"stage_cpu_seconds/{name}", stage.cpu_seconds)
        yield Point(f"stage_peak_mb/{name}", stage.peak_bytes / 1e6)
        yield Point(f"stage_cached/{name}", float(stage.state == "cached"))


def _query_line(query: QueryOutcome, rows: Sequence[Row]) -> dict[str, Any]:
    own = [row for row in rows if row.query == query.query]
    line: dict[str, Any] = {
        "query": query.query,
        "text": own[0].text if own else None,
        "target": own[0].target if own else None,
        "absent": own[0].absent if own else None,
        "found": query.found,
    }
    for column in HEADLINE:
        values = [
            row.metrics[column.metric]
            for row in own
            if row.protocol == column.protocol and column.metric in row.metrics and not row.absent
        ]
        # Over the query's views; None where the object is absent or in none of them.
        line[column.key] = math.fsum(values) / len(values) if values else None
    line |= {
        "confidence": query.confidence,
        "n_flagged": query.n_flagged,
        "location": None if query.location is None else list(query.location),
        "seconds": sum(query.seconds.values()),
        **{f"seconds.{step}": value for step, value in query.seconds.items()},
        "picture": query.picture,
    }
    return line


def _query_points(item: SceneResult, table: Sequence[Mapping[str, Any]]) -> Iterator[Point]:
    for step, (query, line) in enumerate(zip(item.queries, table, strict=True)):
        for name in ("found", "confidence", "seconds", *(column.key for column in HEADLINE)):
            if line[name] is not None:
                yield Point(f"query/{name}", float(line[name]), step)
        for stage, seconds in query.seconds.items():
            yield Point(f"query_seconds/{safe_key(stage)}", seconds, step)
