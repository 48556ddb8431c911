"""Published numbers as sheets: what stands below the measured ones, and never among them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from reports.formats import NONE
from reports.headline_sheets import scene_blocks
from reports.published import Family, PublishedRow
from reports.sheet import JOINT, TERMINAL_WIDTH, Sheet

MARK = "†"
"""Stands behind the name of every method whose numbers were published, not measured here."""

ODD = "‡"
"""Stands behind an overall that is not the mean of its scenes."""

Lines = Sequence[tuple[str, Sequence[Sequence[str]]]]
"""Name of a line, and for each scene and then overall one text per column."""

_NAME_WIDTH = 20


def family_sheets(
    family: Family,
    titles: Mapping[str, str],
    first: Sequence[str],
    wide: bool,
    notes: Sequence[str],
) -> list[Sheet]:
    """The numbers of a family, and the times that were published with them.

    Args:
        family: The numbers.
        titles: Metric -> its title in tables.
        first: Scenes that come first, in this order; the others follow.
        wide: All numbers of a scene in one cell; else a line per number.
        notes: What has to be said of the data.
    """
    metrics = [metric for metric in family.metrics if metric in titles]
    scenes = list(dict.fromkeys([*(s for s in first if s in family.scenes), *family.scenes]))
    sheets = lay_out(
        f"{family.dataset}, {family.about}, published{MARK}",
        [titles[metric] for metric in metrics],
        scenes,
        [(f"{row.method}{MARK}", _cells(row, scenes, metrics)) for row in family.rows],
        (*notes, *_notes(family, titles, wide)),
        wide,
    )
    timed = [row for row in family.rows if row.prepare_seconds or row.query_seconds]
    return [*sheets, _time_sheet(family, timed, wide)] if timed else sheets


def lay_out(
    subject: str,
    titles: Sequence[str],
    scenes: Sequence[str],
    lines: Lines,
    notes: Sequence[str],
    wide: bool,
    unit: str = "per cent",
) -> list[Sheet]:
    """Lines over scenes and overall, in a document's shape or in the terminal's.

    Args:
        subject: Beginning of the title.
        titles: Of the numbers that each place holds.
        scenes: Heads of the columns; overall follows them.
        lines: The content.
        notes: Stand below the last sheet.
        wide: All numbers of a place in one cell; else a line per number, lines that hold none
            left out, and scenes that do not fit in a further sheet.
        unit: Of the numbers.
    """
    title = f"{subject}: {JOINT.join(titles)}, {unit}"
    if wide:
        rows = [(name, *(JOINT.join(place) for place in places)) for name, places in lines]
        columns = ("method", *scenes, "overall")
        return [Sheet(title, columns, tuple(rows), 1, tuple(notes), tuple(titles))]
    names = min(_NAME_WIDTH, max(len("method"), *(len(name) for name, _ in lines)))
    blocks = scene_blocks(scenes, TERMINAL_WIDTH - names - max(6, *map(len, titles)) - 15)
    sheets, start = [], 0
    for number, block in enumerate(blocks, start=1):
        last = number == len(blocks)
        shown = slice(start, None if last else start + len(block))
        start += len(block)
        rows = []
        for name, places in lines:
            here = places[shown]
            kept = [i for i in range(len(titles)) if any(place[i] != NONE for place in here)]
            for i in kept:
                numbers = [place[i] for place in here]
                rows.append((name if i == kept[0] else "", titles[i], *numbers))
        part = "" if len(blocks) == 1 else f" ({number} of {len(blocks)})"
        columns = ("method", "", *block, *(("overall",) if last else ()))
        below = tuple(notes) if last else ()
        sheets.append(Sheet(f"{title}{part}", columns, tuple(rows), 2, below))
    return sheets


def _cells(row: PublishedRow, scenes: Sequence[str], metrics: Sequence[str]) -> list[list[str]]:
    """Each scene, then overall: the number of each metric."""
    spec = ".1f" if row.relative_to is None else "+.1f"
    cells = [[_number(row.scenes.get(scene, {}).get(m), spec) for m in metrics] for scene in scenes]
    overall = [
        _number(row.overall.get(m), spec) + ("" if row.true_overall(m) is None else ODD)
        for m in metrics
    ]
    return [*cells, overall]


def _number(value: float | None, spec: str) -> str:
    return NONE if value is None else format(value, spec)


def _time_sheet(family: Family, rows: Sequence[PublishedRow], wide: bool) -> Sheet:
    notes = ["Each on its authors' machine."]
    if not wide:  # else they stand below the numbers
        notes += _remarks(rows)
    return Sheet(
        title=f"{family.dataset}, {family.about}, published{MARK}: seconds to prepare a scene, "
        "and to answer a query",
        columns=("method", "prepare", "query"),
        rows=tuple(
            (
                f"{row.method}{MARK}",
                _number(row.prepare_seconds, ",g"),
                _number(row.query_seconds, ",g"),
            )
            for row in rows
        ),
        n_names=1,
        notes=tuple(notes),
    )


def _notes(family: Family, titles: Mapping[str, str], wide: bool) -> Iterator[str]:
    odd = [
        f"{row.method} {titles[metric]} {mean:.1f}"
        for row in family.rows
        for metric in row.overall
        if metric in titles and (mean := row.true_overall(metric)) is not None
    ]
    if odd:
        yield f"{ODD} as printed; the mean of its scenes is another: {', '.join(odd)}."
    for row in family.rows:
        if row.relative_to is not None:
            yield f"{row.method}{MARK}: differences to {row.relative_to}{MARK}."
    yield f"Protocol, where nothing else is said: {family.reported_protocol}."
    known = [(row.protocol, row.method) for row in family.rows if row.protocol is not None]
    for protocol, names in _grouped(known):
        yield f"Made by the evaluator that {protocol} follows: {names}."
    other = [
        (row.reported_protocol, row.method)
        for row in family.rows
        if row.protocol is None and row.reported_protocol != family.reported_protocol
    ]
    for protocol, names in _grouped(other):
        yield f"{names}: {protocol}."
    sources = _grouped([(row.source, row.method) for row in family.rows])
    yield f"Sources. {' '.join(f'{names}: {source}.' for source, names in sources)}"
    first_hand = [row.method for row in family.rows if row.first_hand]
    yield f"Read first-hand: {', '.join(first_hand) or 'none'}; the rest is second-hand."
    free = [row.method for row in family.rows if row.training_free]
    if free:
        yield f"Said to train nothing for a scene: {', '.join(free)}."
    if wide:
        yield from _remarks(family.rows)


def _grouped(pairs: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """What names have in common -> these names, listed."""
    groups: dict[str, list[str]] = {}
    for common, name in pairs:
        groups.setdefault(common, []).append(name)
    return [(common, ", ".join(names)) for common, names in groups.items()]


def _remarks(rows: Iterable[PublishedRow]) -> list[str]:
    said = [f"{row.method}: {row.note}" for row in rows if row.note]
    return [f"Remarks. {' '.join(said)}"] if said else []
