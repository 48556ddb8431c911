"""The comparison of a run's lines as sheets: a set for each data set and set of models."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gvr_core.metrics import FLAGS_3D, IN_SCENE_2D
from reports.aggregate import Aggregate
from reports.bootstrap import LEVEL, N_RESAMPLES, Estimate
from reports.comparison import ComparedLine
from reports.formats import NONE, cell_text, estimate_text, seconds_text
from reports.headline import HEADLINE, scene_cell, scene_names
from reports.headline_sheets import scene_blocks
from reports.record import Result
from reports.sheet import TERMINAL_WIDTH, Sheet

_NAME_WIDTH = 20
_IOU_3D = next(column for column in HEADLINE if column.key == "iou_3d")


def comparison_sheets(dataset: str, lines: Sequence[ComparedLine]) -> list[Sheet]:
    """The terminal's shape: 3D IoU and its differences in one sheet, all else in another."""
    sheets = []
    for title, group in _by_model_set(dataset, lines):
        sheets += [
            Sheet(
                title=f"{title}: 3D IoU, per cent",
                columns=("line", "against", "3D IoU", "difference"),
                rows=tuple((line.label, *_overlap_cells(line)) for line in group),
                n_names=2,
                notes=_overlap_notes(group),
            ),
            Sheet(
                title=f"{title}: lowest 3D IoU, views, places, absent objects",
                columns=("line", "lowest in", "lowest", "mIoU", "Acc", "in radius", "AUROC"),
                rows=tuple((line.label, *_lowest(line), *_other_cells(line)) for line in group),
                n_names=2,
                notes=_other_notes(group),
            ),
        ]
    return sheets


def wide_comparison_sheets(dataset: str, lines: Sequence[ComparedLine]) -> list[Sheet]:
    """The document's shape: all figures of a line in one row."""
    sheets = []
    for title, group in _by_model_set(dataset, lines):
        rows = []
        for line in group:
            against, *overlap = _overlap_cells(line)
            scene, lowest = _lowest(line)
            where = f"{lowest} ({scene})" if line.lowest else NONE
            rows.append((line.label, against, *overlap, where, *_other_cells(line)))
        sheets.append(
            Sheet(
                title=f"{title}: lines compared, per cent, and AUROC",
                columns=(
                    *("line", "against", "3D IoU", "difference", "lowest scene"),
                    *("mIoU", "Acc", "in radius", "AUROC"),
                ),
                rows=tuple(rows),
                n_names=2,
                notes=(*_overlap_notes(group), *_other_notes(group)),
            )
        )
    return sheets


def scene_sheets(
    result: Result,
    summary: Aggregate,
    dataset: str,
    lines: Sequence[ComparedLine],
    width: int | None = TERMINAL_WIDTH,
) -> list[Sheet]:
    """3D IoU of each line on each scene.

    Args:
        result: The run.
        summary: Its averages.
        dataset: Name of the data set.
        lines: Its lines.
        width: Columns of text there is room for; scenes that do not fit go on in a further sheet.
            None puts all into one.
    """
    sheets = []
    scenes = scene_names(result, dataset)
    for title, group in _by_model_set(dataset, lines):
        names = min(_NAME_WIDTH, max(len(line.label) for line in group))
        blocks = [scenes] if width is None else scene_blocks(scenes, width - names - 2)
        for number, block in enumerate(blocks, start=1):
            part = "" if len(blocks) == 1 else f" ({number} of {len(blocks)})"
            rows = []
            for line in group:
                cells = [
                    scene_cell(result, summary, dataset, scene, line.name, _IOU_3D)
                    for scene in block
                ]
                rows.append((line.label, *map(cell_text, cells)))
            sheets.append(
                Sheet(
                    title=f"{title}: 3D IoU by scene, per cent{part}",
                    columns=("line", *block),
                    rows=tuple(rows),
                    n_names=1,
                )
            )
    return sheets


def summary_sheets(dataset: str, lines: Sequence[ComparedLine]) -> list[Sheet]:
    """One row a line: mean times, and how often "not here" was answered, rightly and wrongly."""
    return [
        Sheet(
            title=f'{title}: mean seconds, and answers "not here"',
            columns=("line", "prepare", "query", "absent objects", "present objects"),
            rows=tuple(
                (
                    line.label,
                    seconds_text(line.prepare_seconds),
                    seconds_text(line.query_seconds),
                    f"{line.n_refused} of {line.n_absent}" if line.n_absent else NONE,
                    f"{line.n_present_refused} of {line.n_present}" if line.n_present else NONE,
                )
                for line in group
            ),
            n_names=1,
            notes=(
                "Cached stages count with the time of their original computation. Each line on "
                "each scene, and its stages: result.json and MLflow.",
            ),
        )
        for title, group in _by_model_set(dataset, lines)
    ]


def _by_model_set(
    dataset: str, lines: Sequence[ComparedLine]
) -> Iterator[tuple[str, list[ComparedLine]]]:
    """The beginning of the titles, and the lines, of each set of models."""
    for chosen in dict.fromkeys(line.model_set for line in lines):
        title = f"{dataset}, {chosen} models" if chosen else dataset
        yield title, [line for line in lines if line.model_set == chosen]


def _overlap_cells(line: ComparedLine) -> tuple[str, str, str]:
    difference = None if line.difference is None else line.difference.estimate
    return (
        line.reference or NONE,
        estimate_text(line.iou_3d, mark="*" if line.n_missing or line.failed else ""),
        estimate_text(difference, "+.1f"),
    )


def _lowest(line: ComparedLine) -> tuple[str, str]:
    if line.lowest is None:
        return NONE, NONE
    scene, value = line.lowest
    return scene, f"{100 * value:.1f}"


def _other_cells(line: ComparedLine) -> tuple[str, str, str, str]:
    means = (line.miou, line.acc, line.within_radius)
    shown = [NONE if mean is None else f"{100 * mean.value:.1f}" for mean in means]
    return shown[0], shown[1], shown[2], estimate_text(line.auroc, ".2f", 1.0)


def _overlap_notes(lines: Sequence[ComparedLine]) -> tuple[str, ...]:
    notes = [
        f"3D IoU: iou of {FLAGS_3D}; mean over scenes of each scene's mean. Difference: the same "
        "over the queries that both lines were scored on.",
        f"In brackets {LEVEL:.0f} % intervals: percentile bootstrap over scenes, "
        f"{N_RESAMPLES:,} resamples, each line for itself: of lines that change nothing, about "
        "one in twenty will look as if it did.",
    ]
    differences = [line.difference.estimate for line in lines if line.difference]
    if any(_lacks_interval(e) for e in (*(line.iou_3d for line in lines), *differences)):
        notes.append(f"({NONE}): a single scene, so no interval.")
    failed = [f"{line.label} on {', '.join(line.failed)}" for line in lines if line.failed]
    if failed:
        notes.append(f"* failed: {'; '.join(failed)}.")
    missing = [
        f"{line.label} {line.n_missing}" for line in lines if line.n_missing and not line.failed
    ]
    if missing:
        notes.append(f"* queries that others were scored on and it was not: {', '.join(missing)}.")
    left_out = [
        f"{line.label} {line.difference.n_missing}"
        for line in lines
        if line.difference and line.difference.n_missing
    ]
    if left_out:
        notes.append(f"Left out of differences, as only one was scored: {', '.join(left_out)}.")
    return tuple(notes)


def _other_notes(lines: Sequence[ComparedLine]) -> tuple[str, ...]:
    present, absent = (max(getattr(line, n) for line in lines) for n in ("n_present", "n_absent"))
    notes = [
        f"mIoU: iou, Acc: acc_peak of {IN_SCENE_2D}; in radius: L_3D within the object's radius, "
        f"{FLAGS_3D}. AUROC: confidence of {present} queries for present against {absent} for "
        "absent objects; 0.5 is chance."
    ]
    if any(_lacks_interval(line.auroc) for line in lines):
        notes.append(
            f"AUROC ({NONE}): no interval, as a scene lacks present or absent objects, or is the "
            "only one."
        )
    return tuple(notes)


def _lacks_interval(estimate: Estimate | None) -> bool:
    return estimate is not None and estimate.low is None
