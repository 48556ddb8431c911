"""The report of a run: one page that holds everything, made from the result's folder alone."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, UnidentifiedImageError

from gvr_core.metrics import FLAGS_3D
from reports.aggregate import Aggregate, aggregate
from reports.bootstrap import LEVEL, N_RESAMPLES
from reports.comparison import compare, has_references
from reports.comparison_sheets import wide_comparison_sheets
from reports.cost_sheets import refusal_sheets
from reports.evidence import picture_fields, read_evidence, thumbnail_size, to_webp
from reports.formats import estimate_text
from reports.headline import (
    Column,
    dataset_names,
    headings,
    method_names,
    scene_cell,
    scene_names,
)
from reports.headline_sheets import subject_of, wide_headline_sheets
from reports.headline_values import overall_interval
from reports.html_charts import Interval, interval_chart, stage_chart
from reports.html_page import PageTable, Td, name, number, page_tables, render
from reports.paper_table import published_sheets
from reports.record import QueryOutcome, Result, Row, SceneResult
from reports.result_check import ResultError
from reports.result_io import read_result, read_sums
from reports.sheet import Sheet

MOST_BYTES = 28_000_000
"""Evidence beyond this stays out of the page; the page says so."""
MOST_BARS = 16
"""Lines in the chart of stages; the table has all."""
FALLBACK_WIDTH = 480
"""Widest picture of an answer that has no evidence, pixels."""


@dataclass
class _Pictures:
    """What the page holds of evidence, and what it had to leave out."""

    blocks: list[dict[str, Any]] = field(default_factory=list)
    """One for each (scene, method) that has any."""
    of_line: dict[tuple[str, str, str], int] = field(default_factory=dict)
    n_bytes: int = 0
    left_out: list[str] = field(default_factory=list)
    without: int = 0
    """(scene, method) pairs for which nothing was kept."""


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
    pictures = _pictures(folder, result, most_bytes)
    columns = all_columns(result, summary)
    return render(
        "report.html.j2",
        title=f"{result.suite} {result.run_id}",
        result=result,
        created=result.created[:16].replace("T", " "),
        revision=(result.environment.git_revision or "unknown")[:12],
        tiles=_tiles(result, rows, summary, columns),
        failures=[s for s in result.scenes if s.status == "failed"],
        warnings=_warnings(result, summary, pictures),
        coverage=_coverage_table(result, summary),
        headline=[_headline(result, rows, summary, dataset) for dataset in dataset_names(result)],
        comparisons=_comparisons(result, rows),
        scenes=_scene_table(result, summary, columns),
        stages=_stage_table(result),
        stage_charts=_stage_charts(result),
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


def all_columns(result: Result, summary: Aggregate) -> list[Column]:
    """The headline numbers of all data sets of a run, each once."""
    found = {
        (column.protocol, column.metric): column
        for dataset in dataset_names(result)
        for columns in headings(summary, dataset)
        for column in columns
    }
    return list(found.values())


def query_rows(
    result: Result,
    rows: Sequence[Row],
    columns: Sequence[Column],
    blocks: dict[tuple[str, str, str], int],
) -> Iterator[dict[str, Any]]:
    """What the page's table of queries is made from: one record for each line, scene and query.

    Args:
        result: The run.
        rows: Its rows.
        columns: The headline numbers.
        blocks: (data set, scene, method) -> index of its evidence.
    """
    own: dict[tuple[str, str, str, str], list[Row]] = {}
    for row in rows:
        own.setdefault((row.dataset, row.scene, row.method, row.query), []).append(row)
    for scene in result.scenes:
        line = (scene.dataset, scene.scene, scene.method)
        for query in scene.queries:
            yield _query_row(
                scene, query, own.get((*line, query.query), []), columns, blocks.get(line)
            )


def _query_row(
    scene: SceneResult,
    query: QueryOutcome,
    rows: Sequence[Row],
    columns: Sequence[Column],
    block: int | None,
) -> dict[str, Any]:
    values: list[float | None] = []
    by_view: dict[str, list[float | None]] = {}
    for i, column in enumerate(columns):
        found = []
        for row in rows:
            if row.protocol == column.protocol and column.metric in row.metrics and not row.absent:
                found.append(row.metrics[column.metric])
                if row.view is not None:
                    by_view.setdefault(row.view, [None] * len(columns))[i] = found[-1]
        values.append(sum(found) / len(found) if found else None)
    first = rows[0] if rows else None
    return {
        "dataset": scene.dataset,
        "scene": scene.scene,
        "method": scene.method,
        "query": query.query,
        "text": first.text if first else query.query,
        "target": first.target if first else None,
        "absent": first.absent if first else False,
        "found": query.found,
        "confidence": query.confidence,
        "flagged": query.n_flagged,
        "seconds": query.seconds,
        "values": values,
        "views": by_view,
        "block": block,
    }


def _pictures(folder: Path, result: Result, most_bytes: int) -> _Pictures:
    """Evidence, or for results without it the pictures of the answers, as far as there is room."""
    sums = read_sums(folder)
    found = _Pictures()
    for scene in result.scenes:
        key = (scene.dataset, scene.scene, scene.method)
        if scene.evidence is not None:
            block = read_evidence(folder, scene.evidence, sums).model_dump(mode="json")
        elif any(query.picture for query in scene.queries):
            block = {"plain": _plain_pictures(folder, scene)}
        else:
            found.without += scene.status == "completed"
            continue
        size = len(json.dumps(block))
        if found.n_bytes + size > most_bytes:
            found.left_out.append(f"{scene.dataset}/{scene.scene} · {scene.method}")
            continue
        found.n_bytes += size
        found.of_line[key] = len(found.blocks)
        found.blocks.append(block)
    return found


def _plain_pictures(folder: Path, scene: SceneResult) -> dict[str, Any]:
    pictures = {}
    for query in scene.queries:
        if query.picture is not None:
            pictures[query.query] = small_picture(folder / query.picture)
    return pictures


def small_picture(path: Path) -> dict[str, Any]:
    """A picture of a result in small, as the fields of a :class:`reports.evidence.Picture`.

    Raises:
        ResultError: for a file that is missing or no picture.
    """
    try:
        with Image.open(io.BytesIO(path.read_bytes()), formats=["PNG"]) as opened:
            image = opened.convert("RGB")
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise ResultError(f"not a picture: {error}", path=path, accepted="a PNG") from error
    size = thumbnail_size(image.width, image.height, FALLBACK_WIDTH)
    return picture_fields(to_webp(np.asarray(image), FALLBACK_WIDTH), size)


def _tiles(
    result: Result, rows: Sequence[Row], summary: Aggregate, columns: Sequence[Column]
) -> list[dict[str, str]]:
    """The first thing to see: how much of what was planned is in the numbers."""
    n_done = sum(s.status == "completed" for s in result.scenes)
    n_queries = sum(len(s.queries) for s in result.scenes)
    n_found = sum(q.found for s in result.scenes for q in s.queries)
    evaluated = expected = 0
    for dataset, scene, method, column in _places(result, summary):
        value = scene_cell(result, summary, dataset, scene, method, column)
        evaluated += value.n
        expected += value.n_expected
    cached = sum(t.state == "cached" for s in result.scenes for t in s.stages)
    stages = sum(len(s.stages) for s in result.scenes)
    peak = max((t.peak_bytes for s in result.scenes for t in s.stages), default=0)
    state = "good" if n_done == len(result.scenes) else "bad"
    return [
        {
            "state": state,
            "number": f"{n_done} of {len(result.scenes)}",
            "label": "scenes × methods completed",
        },
        {
            "state": "good" if evaluated >= expected else "warn",
            "number": f"{evaluated:,} of {expected:,}",
            "label": "expected scores evaluated",
        },
        {"state": "", "number": f"{n_queries:,}", "label": f"answers, {n_found:,} of them “found”"},
        {"state": "", "number": f"{result.wall_seconds:,.0f} s", "label": "in the run"},
        {"state": "", "number": f"{cached} of {stages}", "label": "stages came from the cache"},
        {"state": "", "number": f"{peak / 1e9:.1f} GB", "label": "peak memory of a stage"},
    ]


def _places(result: Result, summary: Aggregate) -> Iterator[tuple[str, str, str, Column]]:
    """Every cell of the headline tables that can hold a number."""
    for dataset in dataset_names(result):
        for columns in headings(summary, dataset):
            for scene in scene_names(result, dataset):
                for method in method_names(result, dataset):
                    for column in columns:
                        yield dataset, scene, method, column


def _warnings(result: Result, summary: Aggregate, pictures: _Pictures) -> list[str]:
    said = []
    if result.environment.git_dirty:
        said.append("The code had changes that its revision does not hold.")
    if result.environment.git_revision is None:
        said.append("The revision of the code is not known.")
    if result.config.get("limit"):
        said.append(f"Only the first {result.config['limit']} queries of each scene were asked.")
    if pictures.left_out:
        shown = ", ".join(pictures.left_out[:6])
        more = len(pictures.left_out) - 6
        said.append(
            f"No pictures here of {shown}{f' and {more} more' if more > 0 else ''}: the file would "
            "have become too large (--max-mb)."
        )
    single = [n for n in dataset_names(result) if len(scene_names(result, n)) == 1]
    if single:
        said.append(f"A single scene has no interval: {', '.join(single)}.")
    return said


def _coverage_table(result: Result, summary: Aggregate) -> PageTable | None:
    """Places in which less was evaluated than expected; None where there are none."""
    lines = []
    for dataset, scene, method, column in _places(result, summary):
        found = scene_cell(result, summary, dataset, scene, method, column)
        if found.state != "failed" and found.n < found.n_expected:
            lines.append(
                (
                    name(dataset),
                    name(scene),
                    name(method),
                    name(f"{column.metric} of {column.protocol}"),
                    Td(f"{found.n} of {found.n_expected}", found.n / found.n_expected),
                )
            )
    if not lines:
        return None
    heads = ("data set", "scene", "method", "number", "evaluated")
    return PageTable("Not everything that was expected was evaluated", (), heads, 4, tuple(lines))


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


def _scene_table(result: Result, summary: Aggregate, columns: Sequence[Column]) -> PageTable:
    lines = []
    several = len(dataset_names(result)) > 1
    for scene in result.scenes:
        peak = max((timing.peak_bytes for timing in scene.stages), default=None)
        done = scene.status == "completed"
        numbers: list[Td] = []
        least: tuple[int, int] | None = None
        for column in columns:
            found = scene_cell(result, summary, scene.dataset, scene.scene, scene.method, column)
            value = found.value if found.state == "value" else None
            numbers.append(number(value, ".1f", 100.0))
            if found.n_expected and (
                least is None or found.n / found.n_expected < least[0] / least[1]
            ):
                least = (found.n, found.n_expected)
        lines.append(
            (
                name(scene.scene),
                name(scene.method),
                *([name(scene.dataset)] if several else []),
                name(scene.status),
                *numbers,
                Td("–") if least is None else Td(f"{least[0]}/{least[1]}", least[0] / least[1]),
                Td(str(len(scene.queries)), len(scene.queries)),
                Td(str(sum(not q.found for q in scene.queries))) if done else Td("–"),
                number(scene.prepare_seconds if done else None),
                number(scene.query_seconds if done and scene.queries else None, ".2f"),
                number(peak, ",.0f", 1e-6),
                Td(f"{scene.n_gaussians:,}", scene.n_gaussians) if done else Td("–"),
                Td(str(scene.n_views), scene.n_views) if done else Td("–"),
            )
        )
    heads = (
        *("scene", "method", *(["data set"] if several else []), "status"),
        *(_head(column, columns) for column in columns),
        *("evaluated", "queries", "“not here”", "prepare s", "query s", "peak MB"),
        *("Gaussians", "views"),
    )
    return PageTable("Each method on each scene", (), heads, 3 + several, tuple(lines))


def _head(column: Column, columns: Sequence[Column]) -> str:
    """A column's title, with its protocol where another has the same title."""
    alike = [other for other in columns if other.title == column.title]
    return column.title if len(alike) == 1 else f"{column.title} ({column.protocol})"


def _stage_table(result: Result) -> PageTable:
    names = list(dict.fromkeys(t.stage for s in result.scenes for t in s.stages))
    lines = []
    for scene in result.scenes:
        timings = {timing.stage: timing for timing in scene.stages}
        cells = []
        for stage in names:
            timing = timings.get(stage)
            if timing is None:
                cells.append(Td("–"))
                continue
            mark = " ·" if timing.state == "cached" else ""
            cells.append(Td(f"{timing.seconds:.2f}{mark}", timing.seconds))
        peak = max((timing.peak_bytes for timing in scene.stages), default=None)
        cpu = sum(timing.cpu_seconds for timing in scene.stages) if scene.stages else None
        lines.append(
            (
                name(scene.scene),
                name(scene.method),
                *cells,
                number(cpu),
                number(peak, ",.0f", 1e-6),
            )
        )
    heads = ("scene", "method", *names, "cpu s", "peak MB")
    notes = (
        "Seconds of a stage over all queries. · came from the cache, and counts with the time of "
        "its original computation.",
    )
    return PageTable("Seconds by stage, and peak memory", (), heads, 2, tuple(lines), notes)


def _stage_charts(result: Result) -> list[dict[str, Any]]:
    charts = []
    for dataset in dataset_names(result):
        done = [s for s in result.scenes if s.dataset == dataset and s.stages]
        names = list(dict.fromkeys(t.stage for s in done for t in s.stages))
        every = list(dict.fromkeys(s.method for s in done))
        methods = every[:MOST_BARS]
        table = []
        for method in methods:
            own = [s for s in done if s.method == method]
            table.append(
                [
                    sum(t.seconds for s in own for t in s.stages if t.stage == stage) / len(own)
                    for stage in names
                ]
            )
        if methods:
            text = "; ".join(
                f"{m}: {', '.join(f'{n} {v:.1f}' for n, v in zip(names, row, strict=True))}"
                for m, row in zip(methods, table, strict=True)
            )
            svg = stage_chart(methods, names, table)
            few = (
                ""
                if len(methods) == len(every)
                else f", the first {MOST_BARS} of {len(every)} lines"
            )
            title = f"{dataset}: mean over scenes{few}"
            charts.append({"title": title, "svg": svg, "text": text})
    return charts


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
