"""What a run cost, and what it refused, as sheets: times, stages and the answer "not here"."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from reports.aggregate import Aggregate
from reports.formats import NONE, seconds_text
from reports.headline import dataset_names
from reports.record import Damage, Result, SceneResult, StageTiming
from reports.sheet import Sheet

MOST_NAMED = 5
"""So many damaged files are named below a table."""


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
            stage.shown_state,
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


def cache_sheets(result: Result) -> list[Sheet]:
    """How many stages were computed, cached, fetched, and found damaged; none without a stage.

    One row for all scenes, and one for each where something was damaged or not shared. Damaged
    files are named below, the first few of them.
    """
    scenes = [scene for scene in result.scenes if scene.stages]
    if not scenes:
        return []
    rows = [("all", "all", *_cache_counts([stage for s in scenes for stage in s.stages]))]
    for scene in scenes:
        if any(stage.damage or stage.unshared for stage in scene.stages):
            place = f"{scene.dataset} / {scene.scene}"
            rows.append((scene.method, place, *_cache_counts(scene.stages)))
    return [
        Sheet(
            title="stages computed and cached, and what was found damaged in the store",
            columns=(
                *("method", "scene", "computed", "cached", "fetched"),
                *("damaged artifacts", "damaged records", "recomputed for it", "not shared"),
            ),
            rows=tuple(rows),
            n_names=2,
            notes=_cache_notes(result),
        )
    ]


def _cache_counts(stages: Sequence[StageTiming]) -> tuple[str, ...]:
    damage = _damaged_files(stages)
    counts = (
        sum(stage.state == "computed" for stage in stages),
        sum(stage.state == "cached" for stage in stages),
        sum(stage.fetched for stage in stages),
        sum(found.what == "artifact" for found in damage),
        sum(found.what == "record" for found in damage),
        sum(bool(stage.damage) and stage.state == "computed" for stage in stages),
        sum(bool(stage.unshared) for stage in stages),
    )
    return tuple(map(str, counts))


def _damaged_files(stages: Sequence[StageTiming]) -> list[Damage]:
    """Each damaged file once, however many stages name it."""
    return list({(d.where, d.path): d for stage in stages for d in stage.damage}.values())


def _cache_notes(result: Result) -> tuple[str, ...]:
    stages = [stage for scene in result.scenes for stage in scene.stages]
    found = _damaged_files(stages)
    artifacts = sum(damage.what == "artifact" for damage in found)
    healed = sum(bool(stage.damage) and stage.state == "computed" for stage in stages)
    notes = [
        f"Found damaged or unreadable: {artifacts} artifacts and {len(found) - artifacts} records;"
        f" {healed} stages computed again for it."
    ]
    notes += [f"{damage.where} {damage.path} {damage.finding}" for damage in found[:MOST_NAMED]]
    if len(found) > MOST_NAMED:
        notes.append(f"and {len(found) - MOST_NAMED} more, in the result record")
    reasons = [stage.unshared for stage in stages if stage.unshared]
    if reasons:
        notes.append(f"{len(reasons)} stages without the shared store: {reasons[0]}")
    return tuple(notes)
