"""The tables people read: the headline numbers, times, stages and refusals of a run."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from rich.console import Group, RenderableType

from reports.aggregate import Aggregate, aggregate
from reports.headline import (
    HEADLINE,
    Cell,
    dataset_names,
    method_names,
    overall_cell,
    scene_cell,
    scene_names,
)
from reports.record import Result, Row, SceneResult
from reports.sheet import TERMINAL_WIDTH, Sheet, to_markdown, to_rich

NONE = "–"
_NAME_WIDTH = 16
_SCENE_WIDTH = 12


def headline(result: Result, rows: Sequence[Row]) -> RenderableType:
    """Method x scene: Acc, mIoU and 3D IoU, and their means over scenes, for the terminal."""
    return Group(*(to_rich(s) for s in headline_sheets(result, aggregate(rows, result.scenes))))


def timing(result: Result) -> RenderableType:
    """Preparation and query time of each scene and method, for the terminal."""
    return Group(*(to_rich(sheet) for sheet in timing_sheets(result)))


def stages(result: Result) -> RenderableType:
    """What each stage cost, and whether this run computed it, for the terminal."""
    return Group(*(to_rich(sheet) for sheet in stage_sheets(result)))


def refusals(result: Result, rows: Sequence[Row]) -> RenderableType:
    """How often "not here" was answered, rightly and wrongly, for the terminal."""
    return Group(*(to_rich(s) for s in refusal_sheets(result, aggregate(rows, result.scenes))))


def readme_block(result: Result, rows: Sequence[Row]) -> str:
    """Where the numbers come from, and the headline, time and refusal tables, as Markdown."""
    summary = aggregate(rows, result.scenes)
    environment = result.environment
    revision = (environment.git_revision or "unknown")[:12]
    changed = " with local changes" if environment.git_dirty else ""
    source = (
        f"Suite `{result.suite}`, run `{result.run_id}`, {result.created[:10]}, "
        f"revision `{revision}`{changed}, {environment.cpu_count} x {environment.processor}, "
        f"{environment.gpu or 'no GPU'}.\n"
    )
    sheets = [
        *wide_headline_sheets(result, summary),
        *timing_sheets(result),
        *refusal_sheets(result, summary),
    ]
    return "\n".join([source, *(to_markdown(sheet) for sheet in sheets)])


def headline_sheets(result: Result, summary: Aggregate) -> list[Sheet]:
    """The headline in the terminal's shape: a line per metric, a column per scene.

    Scenes that do not fit side by side go on in a further sheet; overall stands in the last.
    """
    sheets = []
    for dataset in dataset_names(result):
        methods = method_names(result, dataset)
        names = min(_NAME_WIDTH, max(len("method"), *(len(m) for m in methods)))
        blocks = _blocks(scene_names(result, dataset), TERMINAL_WIDTH - names - 21)
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
                    rows.append(("" if i else method, column.title, *map(_percent, cells)))
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
            rows.append((method, *(" / ".join(map(_percent, group)) for group in groups)))
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


def timing_sheets(result: Result) -> list[Sheet]:
    """The paper's second table: seconds to prepare a scene and to answer a query."""
    sheets = []
    for dataset in dataset_names(result):
        rows = []
        for scene in (s for s in result.scenes if s.dataset == dataset):
            if scene.status == "failed":
                rows.append((scene.method, scene.scene, "failed", *([NONE] * 5)))
                continue
            width, height = scene.picture_size
            rows.append(
                (
                    scene.method,
                    scene.scene,
                    _seconds(scene.prepare_seconds),
                    _seconds(scene.query_seconds) if scene.queries else NONE,
                    str(len(scene.queries)),
                    str(scene.n_views),
                    f"{width}x{height}",
                    f"{scene.n_gaussians:,}",
                )
            )
        sheets.append(
            Sheet(
                title=f"{dataset}: seconds to prepare a scene, and to answer a query",
                columns=(
                    *("method", "scene", "prepare", "query"),
                    *("queries", "views", "pictures", "Gaussians"),
                ),
                rows=tuple(rows),
                n_names=2,
                notes=("Cached stages count with the time of their original computation.",),
            )
        )
    return sheets


def stage_sheets(result: Result) -> list[Sheet]:
    """Seconds, processor seconds, peak memory and state of each stage; a sheet per scene."""
    return [_stage_sheet(scene) for scene in result.scenes]


def _stage_sheet(scene: SceneResult) -> Sheet:
    rows: list[tuple[str, ...]] = [
        (
            stage.stage,
            stage.state,
            _seconds(stage.seconds),
            _seconds(stage.cpu_seconds),
            f"{stage.peak_bytes / 1e6:,.0f}",
        )
        for stage in scene.stages
    ]
    steps: dict[str, list[float]] = defaultdict(list)
    for query in scene.queries:
        for step, seconds in query.seconds.items():
            steps[step].append(seconds)
    for step, times in steps.items():
        mean = _seconds(sum(times) / len(times))
        rows.append((f"a query: {step}", f"mean of {len(times)}", mean, NONE, NONE))
    notes = [f"failed: {scene.error or 'no reason given'}"] if scene.status == "failed" else []
    return Sheet(
        title=f"{scene.dataset} / {scene.scene}, {scene.method}: stages",
        columns=("stage", "state", "seconds", "cpu s", "peak MB"),
        rows=tuple(rows),
        n_names=2,
        notes=tuple(notes),
    )


def refusal_sheets(result: Result, summary: Aggregate) -> list[Sheet]:
    """Absent objects refused (right) and present ones refused (wrong); none without rows."""
    sheets = []
    for dataset in dataset_names(result):
        rows = [
            (
                found.method,
                found.scene,
                f"{found.n_refused} of {found.n_absent}",
                f"{found.n_present_refused} of {found.n_present}",
            )
            for found in summary.refusals
            if found.dataset == dataset
        ]
        if rows:
            sheets.append(
                Sheet(
                    title=f'{dataset}: answered "not here"',
                    columns=("method", "scene", "absent objects", "present objects"),
                    rows=tuple(rows),
                    n_names=2,
                )
            )
    return sheets


def _blocks(scenes: Sequence[str], room: int) -> list[list[str]]:
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


def _percent(cell: Cell) -> str:
    if cell.state == "failed":
        return "failed"
    if cell.state == "none":
        return NONE
    return f"{100 * cell.value:.1f}{'*' if cell.partial else ''}"


def _seconds(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2f}"
