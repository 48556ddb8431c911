"""What a run cost, and what it refused, as sheets: times, stages and the answer "not here"."""

from __future__ import annotations

from collections import defaultdict

from reports.aggregate import Aggregate
from reports.formats import NONE, seconds_text
from reports.headline import dataset_names
from reports.record import Result, SceneResult
from reports.sheet import Sheet


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
                    seconds_text(scene.prepare_seconds),
                    seconds_text(scene.query_seconds) if scene.queries else NONE,
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
            seconds_text(stage.seconds),
            seconds_text(stage.cpu_seconds),
            f"{stage.peak_bytes / 1e6:,.0f}",
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
