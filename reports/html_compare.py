"""The comparison of two runs as a page, with the pictures of what got better and worse."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from reports.evidence import SceneEvidence, read_evidence
from reports.formats import estimate_text
from reports.html_charts import Interval, interval_chart
from reports.html_page import PageTable, Td, name, number, page_tables, render
from reports.html_pictures import small_picture
from reports.record import Result
from reports.result_io import read_sums
from reports.run_comparison import PairedQuery, RunComparison, datasets_of
from reports.run_comparison_sheets import changed, number_sheets

MOST_SHOWN = 12
"""Queries of each kind with pictures."""
MOST_VIEWS = 2
"""Test views of each of them."""


def compare_page(
    comparison: RunComparison, folders: tuple[Path, Path], fail_if_drop: float | None = None
) -> str:
    """The page of a comparison.

    Args:
        comparison: What was found.
        folders: The folders of A and B, for their pictures.
        fail_if_drop: The points that a number may drop by, where there is such a bound.

    Raises:
        ResultError: for evidence that is damaged.
    """
    worse, better = changed(comparison)
    albums = tuple(
        _Album(result, folder)
        for result, folder in zip((comparison.a, comparison.b), folders, strict=True)
    )
    dropped = [] if fail_if_drop is None else comparison.dropped(fail_if_drop)
    charts = []
    for dataset in datasets_of(comparison):
        shown = [n for n in comparison.numbers if n.dataset == dataset]
        lines = [Interval(f"{n.method} {n.column.title}", n.difference.estimate) for n in shown]
        text = "; ".join(f"{i.label} {estimate_text(i.estimate, '+.1f')}" for i in lines)
        svg = interval_chart(lines, f"B minus A, points ({dataset})")
        charts.append({"title": f"{dataset}: B minus A", "svg": svg, "text": text})
    return render(
        "compare.html.j2",
        title=f"{comparison.a.run_id} and {comparison.b.run_id}",
        comparison=comparison,
        tables=page_tables(number_sheets(comparison)),
        charts=charts,
        fail_if_drop=fail_if_drop,
        dropped=dropped,
        groups=[
            {
                "title": title,
                "n": len(queries),
                "pairs": [_pair(query, albums) for query in queries[:MOST_SHOWN]],
            }
            for title, queries in (("Got worse", worse), ("Got better", better))
        ],
        queries=_query_table(comparison),
    )


class _Album:
    """The pictures of a run, read when they are asked for."""

    def __init__(self, result: Result, folder: Path) -> None:
        self.folder = folder
        self.scenes = {(s.dataset, s.scene, s.method): s for s in result.scenes}
        self.sums = read_sums(folder)
        self.read: dict[str, SceneEvidence] = {}

    def finals(self, query: PairedQuery) -> list[dict[str, Any]]:
        """The answer in a few test views, or the one picture that there is."""
        scene = self.scenes[query.dataset, query.scene, query.method]
        if scene.evidence is not None:
            if scene.evidence not in self.read:
                self.read[scene.evidence] = read_evidence(self.folder, scene.evidence, self.sums)
            for found in self.read[scene.evidence].queries:
                if found.query == query.query:
                    return [each.model_dump() for each in found.finals[:MOST_VIEWS]]
        for outcome in scene.queries:
            if outcome.query == query.query and outcome.picture is not None:
                picture = small_picture(self.folder / outcome.picture)
                return [{**picture, "outline": None, "view": ""}]
        return []


def _pair(query: PairedQuery, albums: Sequence[_Album]) -> dict[str, Any]:
    return {
        "query": query,
        "numbers": [
            {"title": c.title, "a": 100 * a, "b": 100 * b, "change": 100 * (b - a)}
            for c, a, b in query.values
        ],
        "sides": [
            {"run": run, "finals": album.finals(query)}
            for run, album in zip("AB", albums, strict=True)
        ],
    }


def _query_table(comparison: RunComparison) -> PageTable:
    columns = list(dict.fromkeys(c for query in comparison.queries for c, _, _ in query.values))
    lines = []
    for query in comparison.queries:
        values: Mapping[Any, tuple[float, float]] = {c: (a, b) for c, a, b in query.values}
        cells: list[Td] = []
        for column in columns:
            a, b = values.get(column, (None, None))
            change = None if a is None or b is None else b - a
            cells += [number(a, ".1f", 100), number(b, ".1f", 100), number(change, "+.1f", 100)]
        lines.append((name(query.text), name(query.scene), name(query.method), *cells))
    groups = (("", 3), *((column.title, 3) for column in columns))
    heads = ("query", "scene", "method", *("A", "B", "B − A") * len(columns))
    return PageTable("Every query that both have", groups, heads, 3, tuple(lines))
