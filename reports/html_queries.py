"""What the page's table of queries is made from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from reports.aggregate import Aggregate
from reports.headline import Column, dataset_names, headings
from reports.record import QueryOutcome, Result, Row, SceneResult


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
        "text": first.text if first else query.text or query.query,
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
