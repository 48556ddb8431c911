"""The headline numbers of a run as sheets: per scene and overall."""

from __future__ import annotations

from collections.abc import Sequence

from reports.aggregate import Aggregate
from reports.formats import cell_text
from reports.headline import (
    HEADLINE,
    dataset_names,
    method_names,
    overall_cell,
    scene_cell,
    scene_names,
)
from reports.record import Result
from reports.sheet import TERMINAL_WIDTH, Sheet

_NAME_WIDTH = 16
_SCENE_WIDTH = 12


def headline_sheets(result: Result, summary: Aggregate) -> list[Sheet]:
    """The headline in the terminal's shape: a line per metric, a column per scene.

    Scenes that do not fit side by side go on in a further sheet; overall stands in the last.
    """
    sheets = []
    for dataset in dataset_names(result):
        methods = method_names(result, dataset)
        names = min(_NAME_WIDTH, max(len("method"), *(len(m) for m in methods)))
        blocks = scene_blocks(scene_names(result, dataset), TERMINAL_WIDTH - names - 21)
        for number, scenes in enumerate(blocks, start=1):
            last = number == len(blocks)
            rows = []
            for method in methods:
                for i, column in enumerate(HEADLINE):
                    cells = [
                        scene_cell(result, summary, dataset, scene, method, column)
                        for scene in scenes
                    ]
                    if last:
                        cells.append(overall_cell(result, summary, dataset, method, column))
                    rows.append(("" if i else method, column.title, *map(cell_text, cells)))
            part = "" if len(blocks) == 1 else f" ({number} of {len(blocks)})"
            sheets.append(
                Sheet(
                    title=f"{dataset}: localisation accuracy and overlap, per cent{part}",
                    columns=("method", "", *scenes, *(("overall",) if last else ())),
                    rows=tuple(rows),
                    n_names=2,
                    notes=_headline_notes(result, summary, dataset) if last else (),
                )
            )
    return sheets


def wide_headline_sheets(result: Result, summary: Aggregate) -> list[Sheet]:
    """The headline in the paper's shape: a line per method, "Acc / mIoU / 3D IoU" per scene."""
    sheets = []
    for dataset in dataset_names(result):
        scenes = scene_names(result, dataset)
        rows = []
        for method in method_names(result, dataset):
            groups = [
                [scene_cell(result, summary, dataset, scene, method, c) for c in HEADLINE]
                for scene in scenes
            ]
            groups.append([overall_cell(result, summary, dataset, method, c) for c in HEADLINE])
            rows.append((method, *(" / ".join(map(cell_text, group)) for group in groups)))
        titles = " / ".join(column.title for column in HEADLINE)
        sheets.append(
            Sheet(
                title=f"{dataset}: {titles}, per cent",
                columns=("method", *scenes, "overall"),
                rows=tuple(rows),
                n_names=1,
                notes=_headline_notes(result, summary, dataset),
            )
        )
    return sheets


def scene_blocks(scenes: Sequence[str], room: int) -> list[list[str]]:
    """Split scene names so that each block's columns fit into ``room``."""
    blocks: list[list[str]] = [[]]
    used = 0
    for scene in scenes:
        width = min(_SCENE_WIDTH, max(len(scene), 6)) + 2
        if blocks[-1] and used + width > room:
            blocks.append([])
            used = 0
        blocks[-1].append(scene)
        used += width
    return blocks


def _headline_notes(result: Result, summary: Aggregate, dataset: str) -> tuple[str, ...]:
    what = "; ".join(f"{c.title}: {c.metric} of {c.protocol}" for c in HEADLINE)
    notes = [f"{what}. Overall: unweighted mean over scenes."]
    cells = [
        cell
        for method in method_names(result, dataset)
        for column in HEADLINE
        for cell in (
            overall_cell(result, summary, dataset, method, column),
            *(
                scene_cell(result, summary, dataset, scene, method, column)
                for scene in scene_names(result, dataset)
            ),
        )
    ]
    if any(cell.partial for cell in cells):
        notes.append("* not over every scene, or not over every query and view scored by others.")
    return tuple(notes)
