from __future__ import annotations

import pytest
from comparison_samples import make_run
from paper_samples import (
    GG,
    LANGSPLAT,
    OPENGAUSSIAN,
    flat,
    line,
    notes,
    run,
    sheets,
    skipping,
    titled,
)
from record_samples import PLANE, Sample, row, scene_result

from reports.aggregate import aggregate
from reports.headline import HEADLINE, Column, headings, overall_cell, scene_cell
from reports.headline_sheets import headline_sheets, wide_headline_sheets
from reports.paper_table import paper_sheets


def test_existing_data_sets_have_the_three_columns_they_had(sample: Sample) -> None:
    result, rows, _ = sample
    summary = aggregate(rows, result.scenes)
    assert headings(summary, "rooms") == (HEADLINE,)
    assert headings(aggregate([], result.scenes), "rooms") == (HEADLINE,)
    unknown = aggregate([row("cup", "someone.else/1", {"iou": 1.0})])
    assert headings(unknown, "rooms") == (HEADLINE,)
    assert paper_sheets(result, summary) == headline_sheets(result, summary)
    assert paper_sheets(result, summary, wide=True) == wide_headline_sheets(result, summary)


def test_a_data_sets_own_protocols_come_first_and_ours_after() -> None:
    own = row("cup", LANGSPLAT, {"acc": 1.0, "iou": 0.5}, dataset="lerf_ovs", view="v1")
    more = [
        own.model_copy(update={"protocol": OPENGAUSSIAN}),
        own.model_copy(update={"protocol": PLANE}),
        own.model_copy(update={"protocol": "refusal/1"}),
    ]
    first, second, ours = headings(aggregate([more[1], more[2], own, more[0]]), "lerf_ovs")
    assert [c.title for c in first] == ["Acc", "mIoU"] and {c.protocol for c in first} == {
        LANGSPLAT
    }
    assert [c.title for c in second] == ["mIoU", "Acc@0.25", "Acc@0.5"]
    assert ours == HEADLINE[:2]  # no flags, so no 3D IoU
    (alone,) = headings(aggregate([own]), "lerf_ovs")
    assert alone == first


def test_the_class_mean_is_the_number_where_the_protocol_says_so() -> None:
    place = {"dataset": "lerf_mask", "method": "m", "scene": "ramen"}
    rows = [
        row("egg", GG, {"iou": 1.0, "boundary_iou": 0.0}, view="0", **place),
        row("egg", GG, {"iou": 0.0, "boundary_iou": 0.0}, view="1", **place),
        row("bowl", GG, {"iou": 1.0, "boundary_iou": 0.5}, view="0", **place),
        row("egg", PLANE, {"iou": 1.0, "acc_peak": 1.0}, view="0", **place),
        row("egg", PLANE, {"iou": 0.0, "acc_peak": 1.0}, view="1", **place),
        row("bowl", PLANE, {"iou": 1.0, "acc_peak": 1.0}, view="0", **place),
    ]
    made = make_run([(scene_result("ramen", "m", [], dataset="lerf_mask"), rows)])
    summary = aggregate(rows, made[0].scenes)
    (iou, boundary), (_, flat_iou) = headings(summary, "lerf_mask")
    assert (iou.mean, boundary.title, flat_iou.mean) == ("class", "mBIoU", "flat")

    def value(column: Column) -> tuple[float, float]:
        at = (made[0], summary, "lerf_mask")
        return (
            scene_cell(*at, "ramen", "m", column).value,
            overall_cell(*at, "m", column).value,
        )

    assert value(iou) == (0.75, 0.75)
    assert value(boundary) == (0.25, 0.25)
    assert value(flat_iou) == (pytest.approx(2 / 3), pytest.approx(2 / 3))
    sheet = sheets(made, wide=True)[0]
    assert line(sheet, "m")["ramen"] == "75.0 / 25.0"
    assert "over the views of each prompt, then over prompts" in notes(sheet)


def test_coverage_stands_beside_numbers_where_it_is_below_one() -> None:
    wide = sheets(skipping(), wide=True)[0]
    cells = line(wide, "gvr-paper")
    assert cells["ramen"] == "100.0* / 50.0* (3/4)"
    assert cells["figurines"] == "100.0 / 50.0"
    assert cells["teatime"] == "– / – (0/4)"
    assert cells["overall"] == "100.0* / 50.0* (11/16)"
    assert "evaluated of expected" in notes(wide)
    narrow = sheets(skipping())[0]
    assert narrow.rows[1][:2] == ("", "evaluated")
    assert dict(zip(narrow.columns, narrow.rows[1], strict=True))["ramen"] == "3/4"
    assert dict(zip(narrow.columns, narrow.rows[1], strict=True))["figurines"] == ""
    whole = sheets(run({"gvr-paper": flat(0.6)}))[0]
    assert "evaluated" not in [cells[1] for cells in whole.rows]
    difference = titled(sheets(skipping(), wide=True), "minus")
    assert line(difference, "gvr-paper - GVR†")["ramen"] == "+21.0* / -4.1*"
    assert line(difference, "gvr-paper - GVR†")["teatime"] == "– / –"
    assert "* not every expected pair was evaluated." in difference.notes


def test_metrics_of_one_place_may_have_other_coverage() -> None:
    result, rows = run({"m": {"ramen": [(1.0, 0.5)] * 2}})
    rows[1] = rows[1].model_copy(update={"metrics": {"iou": 0.7}})
    found = sheets((result, rows), wide=True)[0]
    assert line(found, "m")["ramen"] == "100.0* (1/2) / 60.0"


def test_a_failed_scene_is_missing_from_overall() -> None:
    result, rows = run({"gvr-paper": flat(0.6), "lift": flat(0.6)})
    failed = [
        item.model_copy(update={"status": "failed", "error": "no masks"})
        if (item.scene, item.method) == ("ramen", "gvr-paper")
        else item
        for item in result.scenes
    ]
    left = [r for r in rows if (r.scene, r.method) != ("ramen", "gvr-paper")]
    found = sheets((result.model_copy(update={"scenes": tuple(failed)}), left), wide=True)
    assert line(found[0], "gvr-paper")["ramen"] == "failed / failed"
    assert line(found[0], "gvr-paper")["overall"] == "100.0* / 60.0* (137/208)"
    difference = line(titled(found, "minus"), "gvr-paper - GVR†")
    assert (difference["ramen"], difference["overall"]) == ("– / –", "– / –")
