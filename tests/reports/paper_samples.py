"""Runs on data sets with protocols of their own, made by hand, and their tables."""

from __future__ import annotations

from comparison_samples import make_run
from record_samples import row, scene_result

from reports.aggregate import aggregate
from reports.paper_table import paper_sheets
from reports.record import Result, Row
from reports.sheet import Sheet

LANGSPLAT = "lerf_ovs.langsplat_2d/1"
OPENGAUSSIAN = "lerf_ovs.opengaussian_3d/1"
GG, GG_COMPAT = "lerf_mask.gg/1", "lerf_mask.gg_compat/1"
SCENES = ("ramen", "figurines", "teatime", "waldo_kitchen")

Run = tuple[Result, list[Row]]
Scores = dict[str, list[tuple[float, float]]]


def run(
    scores: dict[str, Scores],
    dataset: str = "lerf_ovs",
    protocol: str = LANGSPLAT,
    second: str = "acc",
) -> Run:
    """Label -> scene -> (second metric, IoU) of one prompt after the other, in one view each."""
    parts = []
    for label, by_scene in scores.items():
        for scene, values in by_scene.items():
            item = scene_result(scene, label, [], dataset=dataset)
            place = {"dataset": dataset, "scene": scene, "method": label, "view": "v1"}
            rows = [
                row(f"q{i}", protocol, {second: acc, "iou": iou}, **place)
                for i, (acc, iou) in enumerate(values)
            ]
            parts.append((item, rows))
    return make_run(parts)


def flat(value: float) -> Scores:
    """Every scene with an Acc of 1 and this IoU, on as many pairs as are published."""
    pairs = {"ramen": 71, "figurines": 56, "teatime": 59, "waldo_kitchen": 22}
    return {scene: [(1.0, value)] * pairs[scene] for scene in SCENES}


def sheets(made: Run, **options: object) -> list[Sheet]:
    result, rows = made
    return paper_sheets(result, aggregate(rows, result.scenes), **options)  # type: ignore[arg-type]


def titled(found: list[Sheet], words: str) -> Sheet:
    (sheet,) = [sheet for sheet in found if words in sheet.title]
    return sheet


def line(sheet: Sheet, name: str) -> dict[str, str]:
    (cells,) = [cells for cells in sheet.rows if cells[0] == name]
    return dict(zip(sheet.columns, cells, strict=True))


def notes(sheet: Sheet) -> str:
    return "\n".join(sheet.notes)


def skipping() -> Run:
    """One pair of the ramen is skipped, and of the teatime all."""
    result, rows = run({"gvr-paper": {s: [(1.0, 0.5)] * 4 for s in SCENES}})
    kept = []
    for each in rows:
        skipped = (each.scene, each.query) == ("ramen", "q0") or each.scene == "teatime"
        kept.append(each.model_copy(update={"metrics": {"missing": 1.0}}) if skipped else each)
    return result, kept
