"""The single values that a headline number is the mean of."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Iterable, Sequence

from reports.bootstrap import Estimate, interval
from reports.headline import Column
from reports.record import Row

Values = dict[str, dict[Hashable, float]]
"""Scene -> what is averaged over -> value."""


def column_values(rows: Iterable[Row], column: Column, scenes: Sequence[str] = ()) -> Values:
    """What a column's mean over a scene is taken over: pairs, or targets, as its protocol has it.

    Args:
        rows: Rows of one line: one method on one data set.
        column: The headline number.
        scenes: These scenes come first, in this order; those without values are left out.

    Returns:
        For a flat mean (query, view) -> value; for a mean over classes target -> mean over its
        rows. Absent objects are left out.
    """
    pairs: dict[str, dict[Hashable, list[float]]] = {scene: defaultdict(list) for scene in scenes}
    for row in rows:
        if row.protocol == column.protocol and not row.absent and column.metric in row.metrics:
            key: Hashable = (row.query, row.view)
            if column.mean == "class":
                key = row.query if row.target is None else ("target", row.target)
            pairs.setdefault(row.scene, defaultdict(list))[key].append(row.metrics[column.metric])
    return {
        scene: {key: sum(values) / len(values) for key, values in found.items()}
        for scene, found in pairs.items()
        if found
    }


def query_values(rows: Iterable[Row], column: Column) -> dict[tuple[str, str], float]:
    """(scene, query) -> mean of a headline number over the query's views; present objects only."""
    found: dict[tuple[str, str], list[float]] = defaultdict(list)
    for row in rows:
        if row.protocol == column.protocol and not row.absent and column.metric in row.metrics:
            found[row.scene, row.query].append(row.metrics[column.metric])
    return {key: sum(values) / len(values) for key, values in found.items()}


def overall_interval(
    rows: Iterable[Row], column: Column, scenes: Sequence[str] = ()
) -> Estimate | None:
    """A headline number over scenes, with its bootstrap interval."""
    values = column_values(rows, column, scenes)
    return interval({scene: list(pairs.values()) for scene, pairs in values.items()})
