"""What a run cost, and what it refused, as sheets: times, stages and the answer "not here"."""

from __future__ import annotations

from collections import defaultdict

from reports.aggregate import Aggregate
from reports.formats import NONE, seconds_text
from reports.headline import dataset_names
from reports.record import Result, SceneResult
from reports.sheet import Sheet

MIXED = "*"
"""Marks a peak that other work of the same process may be in."""

PEAK_NOTE = (
    "Peak MB: most resident memory of the process while a stage ran, the largest over the stages."
    f" {MIXED}: other scenes ran in threads of the same process, or it is not known whether: theirs"
    " may be in it."
)


def timing_sheets(result: Result) -> list[Sheet]:
    """The paper's second table: seconds to prepare a scene and to answer a query; peak memory."""
    sheets = []
    for dataset in dataset_names(result):
        rows = []
        for scene in (s for s in result.scenes if s.dataset == dataset):
            if scene.status == "failed":
                rows.append((scene.method, scene.scene, "failed", *([NONE] * 6)))
                continue
            width, height = scene.picture_size
            rows.append(
                (
                    scene.method,
                    scene.scene,
                    seconds_text(scene.prepare_seconds),
                    seconds_text(scene.query_seconds) if scene.queries else NONE,
                    str(len(scene.queries)),
                    str(scene.n_views),
                    f"{width}x{height}",
                    f"{scene.n_gaussians:,}",
                    _peak_text(scene),
                )
            )
        notes = ["Cached stages count with the time of their original computation."]
        if any(row[-1] != NONE for row in rows):
            notes.append(PEAK_NOTE)
        sheets.append(
            Sheet(
                title=f"{dataset}: seconds to prepare a scene, and to answer a query",
                columns=(
                    *("method", "scene", "prepare", "query"),
                    *("queries", "views", "pictures", "Gaussians", "peak MB"),
                ),
                rows=tuple(rows),
                n_names=2,
                notes=tuple(notes),
            )
        )
    return sheets


def _peak_text(scene: SceneResult) -> str:
    if not scene.peak_bytes:
        return NONE
    return f"{scene.peak_bytes / 1e6:,.0f}{'' if scene.peak_is_own else MIXED}"


def stage_sheets(result: Result) -> list[Sheet]:
    """Seconds, processor seconds, peak memory and state of each stage; a sheet per scene."""
    return [_stage_sheet(scene) for scene in result.scenes]


def _stage_sheet(scene: SceneResult) -> Sheet:
    rows: list[tuple[str, ...]] = [
        (
            stage.stage,
            stage.state,
            seconds_text(stage.seconds),
            seconds_text(stage.cpu_seconds),
            f"{stage.peak_bytes / 1e6:,.0f}{'' if stage.peak_of == 'stage' else MIXED}",
        )
        for stage in scene.stages
    ]
    steps: dict[str, list[float]] = defaultdict(list)
    for query in scene.queries:
        for step, seconds in query.seconds.items():
            steps[step].append(seconds)
    for step, times in steps.items():
        mean = seconds_text(sum(times) / len(times))
        rows.append((f"a query: {step}", f"mean of {len(times)}", mean, NONE, NONE))
    notes = [f"failed: {scene.error or 'no reason given'}"] if scene.status == "failed" else []
    if not scene.peak_is_own:
        notes.append(PEAK_NOTE)
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
