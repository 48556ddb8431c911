"""The headline numbers of a run as sheets: per scene and overall."""

from __future__ import annotations

from collections.abc import Sequence

from reports.aggregate import Aggregate
from reports.formats import cell_text, coverage_text
from reports.headline import (
    Cell,
    Column,
    dataset_names,
    headings,
    is_own,
    method_names,
    overall_cell,
    scene_cell,
    scene_names,
)
from reports.record import Result
from reports.sheet import JOINT, TERMINAL_WIDTH, Sheet

_NAME_WIDTH = 16
_TITLE_WIDTH = 6
_SCENE_WIDTH = 12
_NUMBER_WIDTH = 6
_EVALUATED = "evaluated"


def headline_sheets(
    result: Result, summary: Aggregate, datasets: Sequence[str] | None = None
) -> list[Sheet]:
    """The headline in the terminal's shape: a line per metric, a column per scene.

    Scenes that do not fit side by side go on in a further sheet; overall stands in the last.

    Args:
        result: The run.
        summary: Its averages.
        datasets: The data sets that are wanted; all of the run where None.
    """
    sheets = []
    for dataset in dataset_names(result) if datasets is None else datasets:
        for columns in headings(summary, dataset):
            sheets += _narrow(result, summary, dataset, columns)
    return sheets


def wide_headline_sheets(
    result: Result, summary: Aggregate, datasets: Sequence[str] | None = None
) -> list[Sheet]:
    """The headline in the paper's shape: a line per method, "Acc / mIoU / 3D IoU" per scene.

    Args:
        result: The run.
        summary: Its averages.
        datasets: The data sets that are wanted; all of the run where None.
    """
    sheets = []
    for dataset in dataset_names(result) if datasets is None else datasets:
        tables = headings(summary, dataset)
        counted = is_own(tables[0])
        for columns in tables:
            scenes = scene_names(result, dataset)
            rows = []
            for method in method_names(result, dataset):
                groups = _groups(result, summary, dataset, method, columns)
                rows.append((method, *(_joined(group, counted) for group in groups)))
            subject = subject_of(dataset, columns, counted)
            sheets.append(
                Sheet(
                    title=f"{subject}: {joined_titles(columns)}, per cent",
                    columns=("method", *scenes, "overall"),
                    rows=tuple(rows),
                    n_names=1,
                    notes=_headline_notes(result, summary, dataset, columns, counted),
                    parts=tuple(column.title for column in columns),
                )
            )
    return sheets


def scene_blocks(scenes: Sequence[str], room: int, least: int = _NUMBER_WIDTH) -> list[list[str]]:
    """Split scene names so that each block's columns, ``least`` wide or more, fit into ``room``."""
    blocks: list[list[str]] = [[]]
    used = 0
    for scene in scenes:
        width = max(least, min(_SCENE_WIDTH, len(scene))) + 2
        if blocks[-1] and used + width > room:
            blocks.append([])
            used = 0
        blocks[-1].append(scene)
        used += width
    return blocks


def joined_titles(columns: Sequence[Column]) -> str:
    """The titles of the numbers that stand in one cell."""
    return JOINT.join(column.title for column in columns)


def subject_of(dataset: str, columns: Sequence[Column], counted: bool = True) -> str:
    """How the title of a headline table begins.

    Args:
        dataset: Name of the data set.
        columns: Of the table.
        counted: Whether the data set has protocols of its own.
    """
    protocol = columns[0].protocol
    if is_own(columns):
        return protocol if protocol.startswith(f"{dataset}.") else f"{dataset}, {protocol}"
    return f"{dataset}, our protocols" if counted else dataset


def _narrow(
    result: Result, summary: Aggregate, dataset: str, columns: tuple[Column, ...]
) -> list[Sheet]:
    methods = method_names(result, dataset)
    names = min(_NAME_WIDTH, max(len("method"), *(len(m) for m in methods)))
    counted = is_own(headings(summary, dataset)[0])
    groups = {m: _groups(result, summary, dataset, m, columns) for m in methods}
    counts = [coverage_text(c) for cells in groups.values() for g in cells for c in g if counted]
    titles = [column.title for column in columns]
    titles += [_EVALUATED] if any(counts) else []
    title_width = max(_TITLE_WIDTH, *(len(title) for title in titles))
    least = max([_NUMBER_WIDTH, *map(len, counts)])
    room = TERMINAL_WIDTH - names - title_width - least - 9
    blocks = scene_blocks(scene_names(result, dataset), room, least)
    sheets = []
    first = 0
    for number, scenes in enumerate(blocks, start=1):
        last = number == len(blocks)
        shown = slice(first, None if last else first + len(scenes))
        first += len(scenes)
        rows = []
        for method in methods:
            for i, column in enumerate(columns):
                cells = [group[i] for group in groups[method][shown]]
                rows.append(("" if i else method, column.title, *map(cell_text, cells)))
                evaluated = [coverage_text(cell) for cell in cells]
                if counted and any(evaluated):
                    rows.append(("", _EVALUATED, *evaluated))
        part = "" if len(blocks) == 1 else f" ({number} of {len(blocks)})"
        what = joined_titles(columns) if counted else "localisation accuracy and overlap"
        sheets.append(
            Sheet(
                title=f"{subject_of(dataset, columns, counted)}: {what}, per cent{part}",
                columns=("method", "", *scenes, *(("overall",) if last else ())),
                rows=tuple(rows),
                n_names=2,
                notes=_headline_notes(result, summary, dataset, columns, counted) if last else (),
            )
        )
    return sheets


def _groups(
    result: Result, summary: Aggregate, dataset: str, method: str, columns: Sequence[Column]
) -> list[list[Cell]]:
    """The cells of each scene, and those of overall at the end."""
    groups = [
        [scene_cell(result, summary, dataset, scene, method, column) for column in columns]
        for scene in scene_names(result, dataset)
    ]
    groups.append([overall_cell(result, summary, dataset, method, column) for column in columns])
    return groups


def _joined(cells: Sequence[Cell], counted: bool) -> str:
    """The numbers of one place; how many pairs were evaluated is said once where it is the same."""
    counts = [coverage_text(cell) if counted else "" for cell in cells]
    if len(set(counts)) == 1:
        return JOINT.join(map(cell_text, cells)) + (f" ({counts[0]})" if counts[0] else "")
    shown = [
        f"{cell_text(c)} ({n})" if n else cell_text(c) for c, n in zip(cells, counts, strict=True)
    ]
    return JOINT.join(shown)


def _headline_notes(
    result: Result,
    summary: Aggregate,
    dataset: str,
    columns: tuple[Column, ...],
    counted: bool,
) -> tuple[str, ...]:
    what = "; ".join(f"{c.title}: {c.metric} of {c.protocol}" for c in columns)
    notes = [f"{what}. Overall: unweighted mean over scenes."]
    if any(column.mean == "class" for column in columns):
        notes.append("A scene: mean over the views of each prompt, then over prompts.")
    cells = [
        cell
        for method in method_names(result, dataset)
        for group in _groups(result, summary, dataset, method, columns)
        for cell in group
    ]
    if any(cell.partial for cell in cells):
        notes.append("* not over every scene, or not over every query and view scored by others.")
    if counted and any(map(coverage_text, cells)):
        notes.append("12/14: evaluated of expected (prompt, view) pairs, where not all were.")
    return tuple(notes)
