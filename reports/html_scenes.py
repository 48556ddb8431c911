"""Each method on each scene, and what it cost: the page's tables and the chart of stages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from reports.aggregate import Aggregate
from reports.headline import Column, dataset_names, scene_cell
from reports.html_charts import stage_chart
from reports.html_page import PageTable, Td, name, number
from reports.record import Result

MOST_BARS = 16
"""Lines in the chart of stages; the table has all."""


def scene_table(result: Result, summary: Aggregate, columns: Sequence[Column]) -> PageTable:
    """Headline numbers, coverage, answers and cost of each method on each scene."""
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


def stage_table(result: Result) -> PageTable:
    """Seconds of each stage, and peak memory, of each method on each scene."""
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


def stage_charts(result: Result) -> list[dict[str, Any]]:
    """For each data set: how the time of each line is shared among the stages."""
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
