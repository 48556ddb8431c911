"""The tables people read: which of them a run gets, in the terminal and in a document."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Group, RenderableType

from reports.aggregate import Aggregate, aggregate
from reports.answer_sheets import answer_sheets, unscored_datasets
from reports.comparison import ComparedLine, compare, has_references
from reports.comparison_sheets import (
    comparison_sheets,
    scene_sheets,
    summary_sheets,
    wide_comparison_sheets,
)
from reports.cost_sheets import cache_sheets, refusal_sheets, stage_sheets, timing_sheets
from reports.headline import dataset_names, method_names
from reports.paper_table import paper_sheets, published_datasets
from reports.record import Result, Row
from reports.sheet import Sheet, to_markdown, to_rich

MANY_LINES = 8
"""With more lines than this on one data set, tables of every line on every scene are left out in
favour of one row a line."""


def overview(result: Result, rows: Sequence[Row]) -> RenderableType:
    """All tables of a run, for the terminal."""
    if is_large(result):
        few = [comparison(result, rows), scenes(result, rows), summary(result, rows)]
        paper = paper_sheets(
            result, aggregate(rows, result.scenes), datasets=published_datasets(result)
        )
        answers = answer_sheets(result, unscored_datasets(result, rows))
        return Group(*map(to_rich, [*paper, *answers]), *few, cache(result))
    parts = [timing(result), refusals(result, rows), stages(result), cache(result)]
    if has_references(result):
        parts = [comparison(result, rows), *parts]
    return Group(headline(result, rows), *parts)


def headline(result: Result, rows: Sequence[Row]) -> RenderableType:
    """Method x scene: the headline numbers and their means over scenes, for the terminal.

    Below those of a data set that numbers were published on stand the published ones. A data set
    without truth has its answers instead.
    """
    return Group(*map(to_rich, _headline(result, rows, aggregate(rows, result.scenes))))


def _headline(
    result: Result, rows: Sequence[Row], averages: Aggregate, wide: bool = False
) -> list[Sheet]:
    """What a run found on each data set: scores, or answers where nothing can be scored."""
    unscored = unscored_datasets(result, rows)
    scored = [name for name in dataset_names(result) if name not in unscored]
    return [
        *paper_sheets(result, averages, wide=wide, datasets=scored),
        *answer_sheets(result, unscored),
    ]


def comparison(result: Result, rows: Sequence[Row]) -> RenderableType:
    """Each line's figures with intervals, and its difference to its reference."""
    sheets = [s for name, lines in _lines(result, rows) for s in comparison_sheets(name, lines)]
    return Group(*map(to_rich, sheets))


def scenes(result: Result, rows: Sequence[Row]) -> RenderableType:
    """3D IoU of each line on each scene, for the terminal."""
    averages = aggregate(rows, result.scenes)
    sheets = [
        sheet
        for name, lines in _lines(result, rows)
        for sheet in scene_sheets(result, averages, name, lines)
    ]
    return Group(*map(to_rich, sheets))


def summary(result: Result, rows: Sequence[Row]) -> RenderableType:
    """Mean times and refusals of each line, for the terminal."""
    sheets = [s for name, lines in _lines(result, rows) for s in summary_sheets(name, lines)]
    return Group(*map(to_rich, sheets))


def timing(result: Result) -> RenderableType:
    """Preparation and query time of each scene and method, for the terminal."""
    return Group(*(to_rich(sheet) for sheet in timing_sheets(result)))


def stages(result: Result) -> RenderableType:
    """What each stage cost, and whether this run computed it, for the terminal."""
    return Group(*(to_rich(sheet) for sheet in stage_sheets(result)))


def cache(result: Result) -> RenderableType:
    """What was cached, and what was found damaged and computed again, for the terminal."""
    return Group(*(to_rich(sheet) for sheet in cache_sheets(result)))


def refusals(result: Result, rows: Sequence[Row]) -> RenderableType:
    """How often "not here" was answered, rightly and wrongly, for the terminal."""
    return Group(*(to_rich(s) for s in refusal_sheets(result, aggregate(rows, result.scenes))))


def readme_block(result: Result, rows: Sequence[Row]) -> str:
    """Where the numbers come from, and the run's tables, as Markdown."""
    averages = aggregate(rows, result.scenes)
    environment = result.environment
    revision = (environment.git_revision or "unknown")[:12]
    changed = " with local changes" if environment.git_dirty else ""
    source = (
        f"Suite `{result.suite}`, run `{result.run_id}`, {result.created[:10]}, "
        f"revision `{revision}`{changed}, {environment.cpu_count} x {environment.processor}, "
        f"{environment.gpu or 'no GPU'}.\n"
    )
    compared = _lines(result, rows) if has_references(result) else []
    comparisons = [s for name, lines in compared for s in wide_comparison_sheets(name, lines)]
    if is_large(result):
        sheets = [
            *paper_sheets(result, averages, wide=True, datasets=published_datasets(result)),
            *answer_sheets(result, unscored_datasets(result, rows)),
            *comparisons,
            *(
                sheet
                for name, lines in compared
                for sheet in scene_sheets(result, averages, name, lines, width=None)
            ),
            *(sheet for name, lines in compared for sheet in summary_sheets(name, lines)),
        ]
    else:
        sheets = [
            *_headline(result, rows, averages, wide=True),
            *comparisons,
            *timing_sheets(result),
            *refusal_sheets(result, averages),
        ]
    return "\n".join([source, *(to_markdown(sheet) for sheet in sheets)])


def is_large(result: Result) -> bool:
    """Whether a run has so many lines that are compared that one row for each has to do."""
    most = max((len(method_names(result, name)) for name in dataset_names(result)), default=0)
    return most > MANY_LINES and has_references(result)


def _lines(result: Result, rows: Sequence[Row]) -> list[tuple[str, list[ComparedLine]]]:
    """Data set -> its lines, compared; those without scores have nothing to compare."""
    unscored = unscored_datasets(result, rows)
    names = [name for name in dataset_names(result) if name not in unscored]
    return [(name, compare(result, rows, name)) for name in names]
