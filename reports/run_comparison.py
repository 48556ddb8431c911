"""Two runs side by side: what changed from one to the other, query by query.

Only like is compared with like. A number is subtracted from a number of the same protocol, in the
same version, over the same (query, view) pairs of the same lines; where the runs differ in any of
these, that is named, and nothing is compared unless the common part is asked for.

Intervals are those of :mod:`reports.bootstrap`: scenes are drawn anew, with all their queries. The
sign test beside them is over queries; those of one scene are not independent, which makes its p too
small. The interval is the one to believe, the test says in how many queries something moved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gvr_core.errors import some_of, unknown_name
from reports.aggregate import aggregate
from reports.bootstrap import Difference, paired
from reports.headline import Column, dataset_names, overall_cell
from reports.headline_values import column_values, query_values
from reports.record import Result, Row
from reports.result_check import ResultError
from reports.run_matching import Line, data_notes, failures, shared_columns, shared_rows

SAME = 1e-9
"""Values nearer than this are the same: sums in another order move the last bits."""


@dataclass(frozen=True)
class SignTest:
    """In how many queries B is above A, and how likely so many would be by chance."""

    n_better: int
    n_worse: int
    n_same: int
    p: float | None
    """Two-sided, exact, of the queries that differ; None where none does."""


@dataclass(frozen=True)
class ComparedNumber:
    """One headline number of one line in both runs."""

    dataset: str
    method: str
    column: Column
    a: float
    """Overall in A, over what is compared."""
    b: float
    difference: Difference
    """B minus A, over the pairs that both have; the interval is over scenes."""
    sign: SignTest

    @property
    def drop(self) -> float:
        """By how many points B is below A."""
        return 100.0 * (self.a - self.b)


@dataclass(frozen=True)
class PairedQuery:
    """One query of one line in both runs."""

    dataset: str
    scene: str
    method: str
    query: str
    text: str
    values: tuple[tuple[Column, float, float], ...]
    """Headline number, its mean over the query's views in A, and in B."""

    @property
    def change(self) -> float:
        """The mean change of its numbers, B minus A: what it is sorted by."""
        return sum(b - a for _, a, b in self.values) / len(self.values)


@dataclass(frozen=True)
class RunComparison:
    """What two runs have in common, compared."""

    a: Result
    b: Result
    numbers: tuple[ComparedNumber, ...]
    queries: tuple[PairedQuery, ...]
    left_out: tuple[str, ...]
    """In what the runs differ, and what was left out of the comparison therefore."""
    notes: tuple[str, ...]
    """What should be known of the data that were compared."""

    def dropped(self, points: float) -> list[ComparedNumber]:
        """The headline numbers that are lower in B by more than so many points."""
        return [number for number in self.numbers if number.drop > points + SAME]


def compare_runs(
    a: tuple[Result, Sequence[Row]],
    b: tuple[Result, Sequence[Row]],
    methods: Sequence[str] = (),
    common: bool = False,
) -> RunComparison:
    """Compare two runs.

    Args:
        a: The earlier run and its rows.
        b: The later one.
        methods: Only these lines; all where left out.
        common: Compare what both have, where they do not have the same.

    Raises:
        ConfigError: for a method that neither run has.
        ResultError: where the runs share no line or no protocol; where they differ in lines,
            queries or views and ``common`` is not set. It names the difference.
    """
    (result_a, rows_a), (result_b, rows_b) = a, b
    lines_a, lines_b = _lines(result_a), _lines(result_b)
    for method in methods:
        if all(method != name for _, name in (*lines_a, *lines_b)):
            known = sorted({name for _, name in (*lines_a, *lines_b)})
            raise unknown_name("method", method, known)
    wanted = [line for line in (*lines_a, *lines_b) if not methods or line[1] in methods]
    both = [line for line in lines_a if line in lines_b and line in wanted]
    left_out = [
        f"{dataset} · {method} only in {'A' if (dataset, method) in lines_a else 'B'}"
        for dataset, method in dict.fromkeys(wanted)
        if (dataset, method) not in both
    ]
    if not both:
        raise ResultError(
            f"{result_a.run_id} and {result_b.run_id} have no line in common: "
            f"{some_of(left_out, 6)}",
            accepted="two runs of one method on one data set",
        )
    summaries = aggregate(rows_a, result_a.scenes), aggregate(rows_b, result_b.scenes)
    columns: dict[str, list[Column]] = {}
    for dataset in dict.fromkeys(dataset for dataset, _ in both):
        columns[dataset] = shared_columns(dataset, summaries, left_out)
    kept_a: list[Row] = []
    kept_b: list[Row] = []
    for line in both:
        mine, theirs, said = shared_rows(
            [row for row in rows_a if (row.dataset, row.method) == line],
            [row for row in rows_b if (row.dataset, row.method) == line],
            columns[line[0]],
        )
        failed_there = failures(line, result_a, result_b)
        left_out += [f"{line[0]} · {line[1]}: {text}" for text in (*failed_there, *said)]
        kept_a += mine
        kept_b += theirs
    if left_out and not common:
        raise ResultError(
            f"{result_a.run_id} (A) and {result_b.run_id} (B) were not asked the same: "
            f"{some_of(left_out, 6)}",
            accepted="runs over the same queries, views and protocols; --common compares what both "
            "have, --method one line",
        )
    numbers = _numbers(both, columns, (result_a, result_b), (kept_a, kept_b))
    if not numbers:
        raise ResultError(
            f"{result_a.run_id} and {result_b.run_id} have no scored query in common",
            accepted="two runs over the same queries",
        )
    queries = [query for line in both for query in _queries(line, columns[line[0]], kept_a, kept_b)]
    notes = data_notes(both, result_a, result_b)
    return RunComparison(
        result_a, result_b, tuple(numbers), tuple(queries), tuple(left_out), tuple(notes)
    )


def sign_test(differences: Sequence[float]) -> SignTest:
    """The exact two-sided sign test; what is the same in both has no say."""
    from scipy.stats import binomtest  # slow to import, and every command imports this module

    better = sum(value > SAME for value in differences)
    worse = sum(value < -SAME for value in differences)
    moved = better + worse
    p = float(binomtest(better, moved, 0.5).pvalue) if moved else None
    return SignTest(better, worse, len(differences) - moved, p)


def _lines(result: Result) -> list[Line]:
    return list(dict.fromkeys((scene.dataset, scene.method) for scene in result.scenes))


def _numbers(
    lines: Sequence[Line],
    columns: dict[str, list[Column]],
    results: tuple[Result, Result],
    rows: tuple[Sequence[Row], Sequence[Row]],
) -> list[ComparedNumber]:
    numbers = []
    summaries = [aggregate(side) for side in rows]
    for dataset, method in lines:
        own = [[r for r in side if (r.dataset, r.method) == (dataset, method)] for side in rows]
        scenes = list(dict.fromkeys(r.scene for r in own[0]))
        for column in columns[dataset]:
            a, b = (
                overall_cell(result, summary, dataset, method, column)
                for result, summary in zip(results, summaries, strict=True)
            )
            difference = paired(
                column_values(own[1], column, scenes), column_values(own[0], column, scenes)
            )
            if difference is None or a.state != "value" or b.state != "value":
                continue
            before, after = (query_values(side, column) for side in own)
            moved = [after[key] - before[key] for key in before if key in after]
            numbers.append(
                ComparedNumber(
                    dataset, method, column, a.value, b.value, difference, sign_test(moved)
                )
            )
    return numbers


def _queries(
    line: Line, columns: Sequence[Column], rows_a: Sequence[Row], rows_b: Sequence[Row]
) -> list[PairedQuery]:
    own = [[r for r in side if (r.dataset, r.method) == line] for side in (rows_a, rows_b)]
    texts = {(row.scene, row.query): row.text for row in own[0]}
    values = [[query_values(side, column) for column in columns] for side in own]
    found = []
    for (scene, query), text in texts.items():
        pairs = tuple(
            (column, before[scene, query], after[scene, query])
            for column, before, after in zip(columns, *values, strict=True)
            if (scene, query) in before and (scene, query) in after
        )
        if pairs:
            found.append(PairedQuery(line[0], scene, line[1], query, text, pairs))
    return found


def datasets_of(comparison: RunComparison) -> list[str]:
    """The data sets that were compared, in the order of A."""
    having = {number.dataset for number in comparison.numbers}
    return [name for name in dataset_names(comparison.a) if name in having]
