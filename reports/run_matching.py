"""What two runs have in common, and a name for everything in which they differ."""

from __future__ import annotations

from collections.abc import Sequence

from gvr_core.errors import some_of
from reports.aggregate import Aggregate
from reports.headline import Column, headings
from reports.protocol_guard import check_same_protocol
from reports.record import Result, Row, SceneResult
from reports.result_check import ResultError

Line = tuple[str, str]
"""Data set and method."""


def shared_columns(
    dataset: str, summaries: tuple[Aggregate, Aggregate], left_out: list[str]
) -> list[Column]:
    """The headline numbers that both runs have; what only one has is said in ``left_out``."""
    ours, theirs = (
        [column for columns in headings(summary, dataset) for column in columns]
        for summary in summaries
    )
    present = [
        {s.protocol for s in summary.scenes if s.dataset == dataset} for summary in summaries
    ]
    shared = [c for c in ours if c in theirs and all(c.protocol in ids for ids in present)]
    protocols = [
        [c.protocol for c in columns if c.protocol in ids]
        for columns, ids in zip((ours, theirs), present, strict=True)
    ]
    if not shared:
        mine, others = (" and ".join(dict.fromkeys(ids)) or "none" for ids in protocols)
        check_same_protocol(mine, others, f"{dataset}, A and B")
        raise ResultError(f"{dataset}: neither run has a headline number")
    for name, ids, other in (("A", *protocols), ("B", *reversed(protocols))):
        left_out += [
            f"{dataset}: {protocol} only in {name}"
            for protocol in dict.fromkeys(ids)
            if protocol not in other
        ]
    return shared


def shared_rows(
    a: Sequence[Row], b: Sequence[Row], columns: Sequence[Column]
) -> tuple[list[Row], list[Row], list[str]]:
    """The rows of each side that the other has too, and in what they differ."""
    asked = [{(r.scene, r.query): (r.text, r.target, r.absent) for r in side} for side in (a, b)]
    said = []
    same: set[tuple[str, str]] = set()
    changed = []
    for key in dict.fromkeys((*asked[0], *asked[1])):
        if asked[0].get(key) == asked[1].get(key):
            same.add(key)
        elif key in asked[0] and key in asked[1]:
            changed.append(f"{key[0]}/{key[1]}")
    for name, mine, other in (("A", asked[0], asked[1]), ("B", asked[1], asked[0])):
        alone = [f"{scene}/{query}" for scene, query in mine if (scene, query) not in other]
        if alone:
            said.append(f"{len(alone)} queries only in {name} ({some_of(alone)})")
    if changed:
        said.append(f"{len(changed)} queries with another text or target ({some_of(changed)})")
    kept: tuple[list[Row], list[Row]] = ([], [])
    scored = [
        {
            (r.scene, r.query, r.view, r.protocol, column.metric)
            for r in side
            for column in columns
            if r.protocol == column.protocol and column.metric in r.metrics
            if (r.scene, r.query) in same
        }
        for side in (a, b)
    ]
    for name, mine, other in (("A", scored[0], scored[1]), ("B", scored[1], scored[0])):
        alone = sorted({f"{s}/{q} in {v or '3D'}" for s, q, v, *_ in mine - other})
        if alone:
            said.append(f"{len(mine - other)} scores only in {name} ({some_of(alone)})")
    pairs = scored[0] & scored[1]
    for side, rows in zip(kept, (a, b), strict=True):
        for row in rows:
            if (row.scene, row.query) not in same:
                continue
            metrics = {
                metric: value
                for metric, value in row.metrics.items()
                if (row.scene, row.query, row.view, row.protocol, metric) in pairs
            }
            side.append(row.model_copy(update={"metrics": metrics}))
    return kept[0], kept[1], said


def failures(line: Line, a: Result, b: Result) -> list[str]:
    """Scenes on which a line failed in one run alone."""
    failed = [
        {s.scene for s in result.scenes if (s.dataset, s.method) == line and s.status == "failed"}
        for result in (a, b)
    ]
    return [
        f"failed in {name} on {some_of(sorted(mine - other))}"
        for name, mine, other in (("A", *failed), ("B", *reversed(failed)))
        if mine - other
    ]


def data_notes(lines: Sequence[Line], a: Result, b: Result) -> list[str]:
    """Parts of the data, and models, that are not those of the other run."""

    def by_place(result: Result) -> dict[tuple[str, str, str], SceneResult]:
        return {
            (s.dataset, s.scene, s.method): s
            for s in result.scenes
            if (s.dataset, s.method) in lines and s.status == "completed"
        }

    mine, theirs = by_place(a), by_place(b)
    changed: dict[str, list[str]] = {}
    for key in mine.keys() & theirs.keys():
        for kind, before, after in (
            ("data", mine[key].digests, theirs[key].digests),
            ("models", mine[key].models, theirs[key].models),
        ):
            parts = [p for p in (*before, *after) if before.get(p) != after.get(p)]
            for part in dict.fromkeys(parts):
                place = f"{key[0]}/{key[1]}" if kind == "data" else f"{key[0]} · {key[2]}"
                changed.setdefault(f"{kind}: {part}", []).append(place)
    return [
        f"Not the same {what} in {some_of(sorted(set(places)))}."
        for what, places in sorted(changed.items())
    ]
