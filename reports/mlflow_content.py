"""What of a record goes into MLflow. Nothing here talks to MLflow.

A benchmark is a run; each (data set, scene, method) is a run below it. The parent's tags stand
on its children too, because a filter in MLflow's pages drops children that lack them.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from reports.aggregate import Aggregate
from reports.comparison import ComparedLine, compare, has_references
from reports.headline import HEADLINE, dataset_names, method_names
from reports.html_report import report_page
from reports.mlflow_run import (
    MAX_VALUE,
    Point,
    RunContent,
    as_table,
    common_tags,
    finite,
    flatten,
    is_class_mean,
    metric_name,
    safe_items,
    safe_key,
)
from reports.mlflow_scene import scene_content
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
            line = _overall_line(result, summary, dataset, method)
            lines.append(line)
            group = _group(result, dataset, method)
            points += [
                Point(safe_key(f"{group}/{name}"), value)
                for name, value in line.items()
                if isinstance(value, (int, float))
            ]
    n_failed = sum(item.status == "failed" for item in result.scenes)
    points += [
        Point("wall_seconds", result.wall_seconds),
        Point("n_scenes", len(result.scenes)),
        Point("n_failed", n_failed),
    ]
    kept, n_left_out = finite(points)
    text = readme_block(result, rows)
    tags = {**common_tags(result), "kind": "benchmark"}
    if len(text) <= MAX_VALUE:  # shown on the run's page; a cut table would not be drawn
        tags["mlflow.note.content"] = text
    params = {"suite": result.suite, **dict(flatten(result.config, "config"))}
    return RunContent(
        name=f"{result.suite} {result.run_id}",
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
    )


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


def _group(result: Result, dataset: str, method: str) -> str:
    """What the metrics of a line begin with: MLflow takes no name with the dot between parts."""
    item = next(s for s in result.scenes if (s.dataset, s.method) == (dataset, method))
    return "/".join(filter(None, (dataset, item.model_set, item.shown_label)))


def _overall_line(result: Result, summary: Aggregate, dataset: str, method: str) -> dict[str, Any]:
    line: dict[str, Any] = {"dataset": dataset, "method": method}
    for part in summary.datasets:
        if (part.dataset, part.method) == (dataset, method):
            for metric, mean in part.metrics.items():
                name = metric_name(part.protocol, metric)
                aliases = [
                    c.key for c in HEADLINE if (c.protocol, c.metric) == (part.protocol, metric)
                ]
                for alias in dict.fromkeys([name, *aliases]):
                    own = mean.class_macro if is_class_mean(part.protocol) else mean.scene_macro
                    line[alias] = own
                    line[f"{alias}_flat"] = mean.scene_macro
                    line[f"{alias}_class_macro"] = mean.class_macro
                    line[f"{alias}_micro"] = mean.micro
    done = [
        item
        for item in result.scenes
        if (item.dataset, item.method, item.status) == (dataset, method, "completed")
    ]
    line["n_scenes"] = len(done)
    line["n_failed"] = sum(
        (item.dataset, item.method, item.status) == (dataset, method, "failed")
        for item in result.scenes
    )
    if done:
        line["prepare_seconds"] = sum(item.prepare_seconds for item in done) / len(done)
        line["query_seconds"] = sum(item.query_seconds for item in done) / len(done)
    return line
