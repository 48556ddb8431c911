"""What a reader has to know before any number: coverage, failures, and what was left out."""

from __future__ import annotations

from collections.abc import Iterator

from reports.aggregate import Aggregate
from reports.headline import (
    Column,
    dataset_names,
    headings,
    method_names,
    scene_cell,
    scene_names,
)
from reports.html_page import PageTable, Td, name
from reports.html_pictures import PagePictures
from reports.record import Result


def tiles(result: Result, summary: Aggregate) -> list[dict[str, str]]:
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


def warnings(result: Result, pictures: PagePictures) -> list[str]:
    """What may mislead a reader of the numbers."""
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


def coverage_table(result: Result, summary: Aggregate) -> PageTable | None:
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
