"""Numbers of different protocols are not compared.

One method has 51.4 mIoU under one protocol and 9.7 under another. So whatever subtracts one number
from another goes through here: within a run, between two runs, and against what was published.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from reports.bootstrap import Difference, paired
from reports.record import Row
from reports.result_check import ResultError

Pair = tuple[str, str | None]
"""A query, and the test view or None."""


def check_same_protocol(mine: str, theirs: str, what: str) -> None:
    """Refuse to compare numbers of two protocols; another version is another protocol.

    Args:
        mine: Protocol id, ``family.name/version``.
        theirs: That of what it is compared with.
        what: What is compared, for the error.

    Raises:
        ResultError: naming both ids, if they differ.
    """
    if mine != theirs:
        raise ResultError(
            f"{what}: numbers of {mine} against numbers of {theirs}",
            accepted="numbers of one protocol; gvr score --protocol ID scores a result again",
        )


def protocols_with(rows: Iterable[Row], metric: str) -> tuple[str, ...]:
    """The protocols under which rows have a metric, in the order of the rows."""
    return tuple(dict.fromkeys(row.protocol for row in rows if metric in row.metrics))


def paired_rows(
    rows: Sequence[Row],
    reference: Sequence[Row],
    metric: str,
    protocol: str | None = None,
    scenes: Sequence[str] = (),
) -> Difference | None:
    """How much larger a metric is in one line's rows than in another's, of one run or of two.

    Args:
        rows: Rows of one line: one method on one data set.
        reference: Rows of the line it is compared with; they are subtracted.
        metric: Name of the metric.
        protocol: Id of the protocol; may be left out where the rows have the metric under one
            alone.
        scenes: The order in which scenes are drawn for the interval; that of the rows where it is
            left out.

    Returns:
        The difference over the (query, view) pairs of present objects that both have; None where
        no pair is in both.

    Raises:
        ResultError: where one side has the metric under another protocol than the other, or under
            several while none was named; where a side has rows of several lines, or the two are of
            different data sets.
    """
    _check_lines(rows, reference)
    mine, theirs = (_protocol_of(side, metric, protocol) for side in (rows, reference))
    if mine is None or theirs is None:
        return None
    check_same_protocol(mine, theirs, metric)
    return paired(
        values_by_scene(rows, mine, metric, scenes),
        values_by_scene(reference, mine, metric, scenes),
    )


def values_by_scene(
    rows: Iterable[Row], protocol: str, metric: str, scenes: Sequence[str] = ()
) -> dict[str, dict[Pair, float]]:
    """One metric of one line: scene -> (query, view) -> value, for present objects.

    Args:
        rows: Rows of one line.
        protocol: Id of the protocol.
        metric: Name of the metric.
        scenes: These scenes come first, in this order; those without values are left out.
    """
    values: dict[str, dict[Pair, float]] = {scene: {} for scene in scenes}
    for row in rows:
        if row.protocol == protocol and not row.absent and metric in row.metrics:
            values.setdefault(row.scene, {})[row.query, row.view] = row.metrics[metric]
    return {scene: pairs for scene, pairs in values.items() if pairs}


def _protocol_of(rows: Sequence[Row], metric: str, wanted: str | None) -> str | None:
    """The protocol under which a side's numbers are meant; None where it has none at all."""
    found = protocols_with(rows, metric)
    if wanted in found or not found:
        return wanted if found else None
    if len(found) > 1:
        raise ResultError(
            f"{metric} is there under {' and '.join(found)}",
            accepted="one protocol" if wanted is None else wanted,
        )
    if wanted is not None:
        check_same_protocol(wanted, found[0], metric)
    return found[0]


def _check_lines(*sides: Iterable[Row]) -> None:
    """Each side is one line, and all are of one data set."""
    lines = [list(dict.fromkeys((row.dataset, row.method) for row in side)) for side in sides]
    shown = [[" / ".join(line) for line in side[:3]] for side in lines]
    for side, names in zip(lines, shown, strict=True):
        if len(side) > 1:
            raise ResultError(
                f"rows of {len(side)} lines: {', '.join(names)}",
                accepted="rows of one method on one data set",
            )
    if len({dataset for side in lines for dataset, _ in side}) > 1:
        raise ResultError(
            f"rows of {' against rows of '.join(name for names in shown for name in names)}",
            accepted="rows on one data set",
        )
