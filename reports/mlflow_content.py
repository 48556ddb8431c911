"""What of a record goes into MLflow. Nothing here talks to MLflow.

A benchmark is a run; each (data set, scene, method) is a run below it. The parent's tags stand
on its children too, because a filter in MLflow's pages drops children that lack them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from reports.aggregate import Aggregate
from reports.comparison import ComparedLine, compare, has_references
from reports.headline import dataset_names, method_names
from reports.html_report import report_page
from reports.mlflow_line import line_points, overall_line
from reports.mlflow_run import (
    MAX_VALUE,
    Point,
    RunContent,
    as_table,
    common_tags,
    finite,
    flatten,
    safe_items,
    safe_key,
    shown_time,
)
from reports.mlflow_scene import inputs, scene_content
from reports.record import Result, Row
from reports.result_io import RESULT_FILE, ROWS_FILE, SUMS_FILE, TABLE_FILE
from reports.tables import readme_block

_FILES = (RESULT_FILE, ROWS_FILE, TABLE_FILE, SUMS_FILE)


def run_contents(
    folder: Path, result: Result, rows: Sequence[Row], summary: Aggregate
) -> list[RunContent]:
    """The contents of a result's runs, the parent's first.

    Args:
        folder: The result's folder.
        result: What it holds.
        rows: Its rows.
        summary: Their averages.
    """
    by_scene: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        by_scene.setdefault((row.dataset, row.scene, row.method), []).append(row)
    children = [
        scene_content(
            folder, result, item, by_scene.get((item.dataset, item.scene, item.method), []), summary
        )
        for item in result.scenes
    ]
    return [_benchmark_content(folder, result, rows, summary), *children]


def _benchmark_content(
    folder: Path, result: Result, rows: Sequence[Row], summary: Aggregate
) -> RunContent:
    lines = []
    points: list[Point] = []
    for dataset in dataset_names(result):
        for method in method_names(result, dataset):
            line = overall_line(result, summary, dataset, method)
            lines.append(line)
            points += line_points(result, summary, dataset, method, line)
    n_failed = sum(item.status == "failed" for item in result.scenes)
    points = [
        Point("wall_seconds", result.wall_seconds),
        Point("n_scenes", len(result.scenes)),
        Point("n_failed", n_failed),
        *points,
        *_system_points(result),
    ]
    kept, n_left_out = finite(points)
    text = readme_block(result, rows)
    tags = {"kind": "benchmark", **common_tags(result)}
    if len(text) <= MAX_VALUE:  # shown on the run's page; a cut table would not be drawn
        tags["mlflow.note.content"] = text
    params = {"suite": result.suite, **dict(flatten(result.config, "config"))}
    return RunContent(
        name=f"{result.suite} {shown_time(result)}",
        failed=n_failed > 0,
        seconds=result.wall_seconds,
        tags=safe_items(tags),
        params=safe_items(params),
        points=kept,
        n_left_out=n_left_out,
        files=tuple((folder / name, "") for name in _FILES),
        tables=_tables(result, rows, lines),
        texts={"summary.md": text},
        made={"report.html": partial(report_page, folder)},
        datasets=tuple(dict.fromkeys(d for item in result.scenes for d in inputs(result, item))),
    )


def _system_points(result: Result) -> Iterator[Point]:
    """MLflow's pages show what is called so in a tab of its own, over time."""
    if result.system is not None:
        for name, values in result.system.values.items():
            moments = zip(result.system.seconds, values, strict=True)
            for step, (seconds, value) in enumerate(moments):
                yield Point(safe_key(f"system/{name}"), value, step, seconds)


def _tables(
    result: Result, rows: Sequence[Row], lines: Sequence[dict[str, Any]]
) -> dict[str, dict[str, Any]]:
    tables = {"summary.json": as_table(lines)} if lines else {}
    if has_references(result):
        compared = [
            {"dataset": dataset, **_flat(line)}
            for dataset in dataset_names(result)
            for line in compare(result, rows, dataset)
        ]
        tables["comparison.json"] = as_table(compared)
    return tables


def _flat(line: ComparedLine) -> dict[str, Any]:
    """A compared line as columns: of each estimate its value and the ends of its interval."""
    difference = line.difference
    estimates = {
        "iou_3d": line.iou_3d,
        "difference": None if difference is None else difference.estimate,
        "miou": line.miou,
        "acc": line.acc,
        "within_radius": line.within_radius,
        "auroc": line.auroc,
    }
    flat: dict[str, Any] = {
        "label": line.label,
        "model_set": line.model_set,
        "reference": line.reference,
    }
    for name, estimate in estimates.items():
        flat[name] = None if estimate is None else estimate.value
        flat[f"{name}_low"] = None if estimate is None else estimate.low
        flat[f"{name}_high"] = None if estimate is None else estimate.high
    return flat | {
        "lowest_scene": line.lowest[0] if line.lowest else None,
        "n_pairs": difference.n_pairs if difference else None,
    }
