"""The comparison of two runs as sheets."""

from __future__ import annotations

from collections.abc import Sequence

from reports.bootstrap import LEVEL, N_RESAMPLES
from reports.formats import NONE, estimate_text
from reports.run_comparison import (
    SAME,
    ComparedNumber,
    PairedQuery,
    RunComparison,
    datasets_of,
)
from reports.sheet import Sheet

MOST_QUERIES = 10
"""So many queries of each kind are listed in the terminal."""


def number_sheets(comparison: RunComparison) -> list[Sheet]:
    """Each headline number in A and in B, the difference, and the sign test; one per data set."""
    sheets = []
    for dataset in datasets_of(comparison):
        shown = [number for number in comparison.numbers if number.dataset == dataset]
        sheets.append(
            Sheet(
                title=f"{dataset}: A, B and B minus A, per cent and points",
                columns=("method", "number", "A", "B", "B - A", "better", "worse", "p"),
                rows=tuple(_number_row(number) for number in shown),
                n_names=2,
                notes=_notes(shown),
            )
        )
    return sheets


def query_sheets(comparison: RunComparison, most: int = MOST_QUERIES) -> list[Sheet]:
    """The queries that changed most, those that got worse first."""
    worse, better = changed(comparison)
    sheets = []
    for title, queries in (("worse", worse), ("better", better)):
        if queries:
            more = len(queries) - most
            sheets.append(
                Sheet(
                    title=f"Got {title}: {len(queries)} queries",
                    columns=("query", "place", "A", "B"),
                    rows=tuple(_query_row(query) for query in queries[:most]),
                    n_names=2,
                    notes=(f"and {more} more",) if more > 0 else (),
                )
            )
    return sheets


def changed(comparison: RunComparison) -> tuple[list[PairedQuery], list[PairedQuery]]:
    """The queries whose numbers got worse on average, and better; the largest change first."""
    moved = sorted(comparison.queries, key=lambda query: query.change)
    worse = [query for query in moved if query.change < -SAME]
    better = [query for query in reversed(moved) if query.change > SAME]
    return worse, better


def _number_row(number: ComparedNumber) -> tuple[str, ...]:
    sign = number.sign
    return (
        number.method,
        number.column.title,
        f"{100 * number.a:.1f}",
        f"{100 * number.b:.1f}",
        estimate_text(number.difference.estimate, "+.1f"),
        str(sign.n_better),
        str(sign.n_worse),
        NONE if sign.p is None else f"{sign.p:.3f}",
    )


def _query_row(query: PairedQuery) -> tuple[str, ...]:
    before = " / ".join(f"{100 * a:.0f}" for _, a, _ in query.values)
    after = " / ".join(f"{100 * b:.0f}" for _, _, b in query.values)
    return f"“{query.text}”", f"{query.scene} · {query.method}", before, after


def _notes(numbers: Sequence[ComparedNumber]) -> tuple[str, ...]:
    columns = dict.fromkeys(number.column for number in numbers)
    named = "; ".join(f"{c.title}: {c.metric} of {c.protocol}" for c in columns)
    n_scenes = max(number.difference.estimate.n_scenes for number in numbers)
    notes = [
        f"{named}.",
        f"In brackets {LEVEL:.0f} % intervals: percentile bootstrap over the {n_scenes} scenes, "
        f"each with all its queries, {N_RESAMPLES:,} resamples.",
        "better, worse: queries; p: two-sided sign test over the queries that changed. Queries of "
        "one scene are not independent, so p is too small.",
    ]
    if n_scenes == 1:
        notes[1] = f"({NONE}): a single scene, so no interval."
    return tuple(notes)
