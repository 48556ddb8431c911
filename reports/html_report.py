"""The report of a run: one page that holds everything, made from the result's folder alone."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gvr_core.metrics import FLAGS_3D
from reports.aggregate import Aggregate, aggregate
from reports.bootstrap import LEVEL, N_RESAMPLES
from reports.comparison import compare, has_references
from reports.comparison_sheets import wide_comparison_sheets
from reports.cost_sheets import refusal_sheets
from reports.formats import estimate_text
from reports.headline import dataset_names, headings, method_names, scene_names
from reports.headline_sheets import subject_of, wide_headline_sheets
from reports.headline_values import overall_interval
from reports.html_charts import Interval, interval_chart
from reports.html_overview import coverage_table, tiles, warnings
from reports.html_page import page_tables, render
from reports.html_pictures import page_pictures
from reports.html_queries import all_columns, query_rows
from reports.html_scenes import scene_table, stage_charts, stage_table
from reports.paper_table import published_sheets
from reports.record import Result, Row
from reports.result_io import read_result
from reports.sheet import Sheet

MOST_BYTES = 28_000_000
"""Evidence beyond this stays out of the page; the page says so."""


def report_page(folder: Path, most_bytes: int = MOST_BYTES) -> str:
    """The report of a result.

    Args:
        folder: The result's folder.
        most_bytes: Evidence beyond this is left out, and said to be.

    Returns:
        HTML that needs no other file and asks for none.

    Raises:
        ResultError: for a folder that is no result, or evidence that is damaged.
    """
    result, rows = read_result(folder)
    summary = aggregate(rows, result.scenes)
    pictures = page_pictures(folder, result, most_bytes)
    columns = all_columns(result, summary)
    return render(
        "report.html.j2",
        title=f"{result.suite} {result.run_id}",
        result=result,
        created=result.created[:16].replace("T", " "),
        revision=(result.environment.git_revision or "unknown")[:12],
        tiles=tiles(result, summary),
        failures=[s for s in result.scenes if s.status == "failed"],
        warnings=warnings(result, pictures),
        coverage=coverage_table(result, summary),
        headline=[_headline(result, rows, summary, dataset) for dataset in dataset_names(result)],
        comparisons=_comparisons(result, rows),
        scenes=scene_table(result, summary, columns),
        stages=stage_table(result),
        stage_charts=stage_charts(result),
        refusals=page_tables(refusal_sheets(result, summary)),
        setups=_setups(result),
        config=json.dumps(result.config, indent=1, sort_keys=True),
        packages=sorted(result.environment.packages.items()),
        level=f"{LEVEL:.0f}",
        n_resamples=f"{N_RESAMPLES:,}",
        data={
            "columns": [
                {"title": c.title, "protocol": c.protocol, "metric": c.metric} for c in columns
            ],
            "rows": list(query_rows(result, rows, columns, pictures.of_line)),
        },
        blocks=pictures.blocks,
    )


def _headline(
    result: Result, rows: Sequence[Row], summary: Aggregate, dataset: str
) -> dict[str, Any]:
    """The paper's table of a data set: measured, with intervals, and what was published on it."""
    scenes = scene_names(result, dataset)
    intervals = []
    for columns in headings(summary, dataset):
        lines = []
        for method in method_names(result, dataset):
            own = [row for row in rows if (row.dataset, row.method) == (dataset, method)]
            texts = [estimate_text(overall_interval(own, column, scenes)) for column in columns]
            lines.append((method, *texts))
        intervals.append(
            Sheet(
                title=f"{subject_of(dataset, columns)}: overall with {LEVEL:.0f} % interval",
                columns=("method", *(column.title for column in columns)),
                rows=tuple(lines),
                n_names=1,
            )
        )
    return {
        "dataset": dataset,
        "measured": page_tables(wide_headline_sheets(result, summary, [dataset])),
        "published": page_tables(published_sheets(result, summary, dataset, wide=True)),
        "intervals": page_tables(intervals),
    }


def _comparisons(result: Result, rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Lines against the ones that they refer to: the ablation chart, and its numbers."""
    found = []
    solid = {row.dataset for row in rows if row.protocol == FLAGS_3D}
    for dataset in dataset_names(result) if has_references(result) else []:
        if dataset not in solid:
            continue
        lines = compare(result, rows, dataset)
        groups: dict[tuple[str, str], list[Interval]] = {}
        for line in lines:
            if line.reference is not None and line.difference is not None:
                shown = Interval(line.label, line.difference.estimate)
                groups.setdefault((line.model_set, line.reference), []).append(shown)
        charts = [_difference_chart(dataset, *key, shown) for key, shown in groups.items()]
        tables = page_tables(wide_comparison_sheets(dataset, lines))
        found.append({"dataset": dataset, "charts": charts, "tables": tables})
    return found


def _difference_chart(
    dataset: str, model_set: str, reference: str, lines: Sequence[Interval]
) -> dict[str, Any]:
    models = f", {model_set} models" if model_set else ""
    title = f"{dataset}{models}: 3D IoU against {reference}"
    texts = [f"{line.label} {estimate_text(line.estimate, '+.1f')}" for line in lines]
    return {
        "title": title,
        "svg": interval_chart(lines, "difference, points"),
        "text": f"{title}: {'; '.join(texts)}",
    }


def _setups(result: Result) -> list[dict[str, Any]]:
    """Models and digests, once for each method that shares them on all scenes."""
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for scene in result.scenes:
        key = (scene.dataset, scene.method)
        entry = found.setdefault(
            key, {"dataset": scene.dataset, "method": scene.method, "models": {}, "scenes": []}
        )
        entry["models"].update(scene.models)
        entry["scenes"].append((scene.scene, sorted(scene.digests.items())))
    return list(found.values())
