from __future__ import annotations

import pytest
from comparison_samples import scene_line, small_run
from record_samples import PLANE, SOLID, row

from reports.bootstrap import paired
from reports.comparison import compare
from reports.protocol_guard import (
    check_same_protocol,
    paired_rows,
    protocols_with,
    values_by_scene,
)
from reports.record import Row
from reports.result_check import ResultError

LANGSPLAT = "lerf_ovs.langsplat_2d/1"
OPENGAUSSIAN = "lerf_ovs.opengaussian_3d/1"


def line(protocol: str, *values: float, **fields: object) -> list[Row]:
    return [row(f"q{i}", protocol, {"iou": v}, view="v1", **fields) for i, v in enumerate(values)]


def test_one_protocol_passes_and_two_are_named() -> None:
    check_same_protocol(LANGSPLAT, LANGSPLAT, "iou")
    with pytest.raises(ResultError) as caught:
        check_same_protocol(LANGSPLAT, OPENGAUSSIAN, "mIoU of base")
    assert LANGSPLAT in str(caught.value) and OPENGAUSSIAN in str(caught.value)
    assert "mIoU of base" in str(caught.value)


def test_another_version_is_another_protocol() -> None:
    with pytest.raises(ResultError, match=r"langsplat_2d/1 against numbers of .*langsplat_2d/2"):
        check_same_protocol(LANGSPLAT, "lerf_ovs.langsplat_2d/2", "iou")


def test_rows_of_two_runs_under_one_protocol() -> None:
    found = paired_rows(line(LANGSPLAT, 0.5, 0.9), line(LANGSPLAT, 0.25, 0.75, 0.1), "iou")
    assert found is not None
    assert found.estimate.value == pytest.approx(0.2)
    assert (found.n_pairs, found.n_missing) == (2, 1)


@pytest.mark.parametrize("named", [None, LANGSPLAT, OPENGAUSSIAN])
def test_rows_of_two_runs_under_two_protocols_are_refused(named: str | None) -> None:
    with pytest.raises(ResultError) as caught:
        paired_rows(line(LANGSPLAT, 0.5), line(OPENGAUSSIAN, 0.1), "iou", named)
    assert LANGSPLAT in str(caught.value) and OPENGAUSSIAN in str(caught.value)


def test_of_several_protocols_one_has_to_be_named() -> None:
    both = [*line(LANGSPLAT, 0.5), *line(OPENGAUSSIAN, 0.1)]
    assert protocols_with(both, "iou") == (LANGSPLAT, OPENGAUSSIAN)
    with pytest.raises(ResultError, match=f"under {LANGSPLAT} and {OPENGAUSSIAN}"):
        paired_rows(both, both, "iou")
    with pytest.raises(ResultError, match=r"accepted: gvr\.in_scene_2d/1"):
        paired_rows(both, line(PLANE, 0.5), "iou", PLANE)
    found = paired_rows(both, line(OPENGAUSSIAN, 0.4), "iou", OPENGAUSSIAN)
    assert found is not None and found.estimate.value == pytest.approx(-0.3)


def test_rows_without_the_metric_have_no_difference() -> None:
    assert paired_rows(line(LANGSPLAT, 0.5), line(LANGSPLAT, 0.5), "acc") is None
    assert paired_rows(line(LANGSPLAT, 0.5), [], "iou") is None
    absent = line(LANGSPLAT, 0.5, absent=True)
    assert paired_rows(absent, absent, "iou") is None


def test_rows_of_several_lines_or_data_sets_are_refused() -> None:
    one, other = line(PLANE, 0.5), line(PLANE, 0.5, method="lift")
    with pytest.raises(ResultError, match="rows of 2 lines: rooms / gvr-paper, rooms / lift"):
        paired_rows([*one, *other], one, "iou")
    assert paired_rows(one, other, "iou") is not None
    with pytest.raises(ResultError, match="against rows of lerf_ovs / gvr-paper"):
        paired_rows(one, line(PLANE, 0.5, dataset="lerf_ovs"), "iou")


def test_scenes_stand_in_the_order_asked_for() -> None:
    rows = [*line(PLANE, 0.5, scene="b"), *line(PLANE, 0.25, scene="a"), *line(SOLID, 1.0)]
    assert values_by_scene(rows, PLANE, "iou") == {
        "b": {("q0", "v1"): 0.5},
        "a": {("q0", "v1"): 0.25},
    }
    assert list(values_by_scene(rows, PLANE, "iou", ["c", "a", "b"])) == ["a", "b"]


def test_lines_within_a_run_are_compared_through_it() -> None:
    result, rows = small_run()
    lines = {each.label: each for each in compare(result, rows, "rooms")}
    mine, base = ([r for r in rows if r.method == name] for name in ("w/o votes", "base"))
    assert lines["w/o votes"].difference == paired_rows(mine, base, "iou", SOLID)
    scenes = ["kitchen", "garden", "attic"]
    plain = paired(*(values_by_scene(side, SOLID, "iou", scenes) for side in (mine, base)))
    assert lines["w/o votes"].difference == plain
    assert plain is not None and plain.estimate.value == pytest.approx(-0.1)


def test_a_reference_without_flags_leaves_no_difference_and_no_error() -> None:
    _, rows = scene_line("kitchen", "base", {"cup": 0.4})
    result, all_rows = small_run()
    kept = [r for r in all_rows if not (r.method == "base" and r.protocol == SOLID)]
    lines = {each.label: each for each in compare(result, kept, "rooms")}
    assert lines["w/o votes"].difference is None
    assert lines["base"].iou_3d is None and rows
