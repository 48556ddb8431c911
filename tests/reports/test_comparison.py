from __future__ import annotations

import pytest
from comparison_samples import make_run, scene_line, small_run
from record_samples import SOLID, Sample, row

from reports.aggregate import aggregate
from reports.bootstrap import Estimate
from reports.comparison import ComparedLine, compare, has_references
from reports.headline import HEADLINE, overall_cell


@pytest.fixture
def lines() -> dict[str, ComparedLine]:
    result, rows = small_run()
    return {line.name: line for line in compare(result, rows, "rooms")}


def value(estimate: Estimate | None) -> float:
    assert estimate is not None
    return estimate.value


def test_means_are_those_of_the_headline(lines: dict[str, ComparedLine]) -> None:
    result, rows = small_run()
    summary = aggregate(rows, result.scenes)
    for line in lines.values():
        for column, estimate in zip(HEADLINE, (line.acc, line.miou, line.iou_3d), strict=True):
            cell = overall_cell(result, summary, "rooms", line.name, column)
            assert value(estimate) == pytest.approx(cell.value)
    assert value(lines["base"].iou_3d) == pytest.approx((0.5 + 0.5 + 0.9) / 3)


def test_each_line_is_compared_with_its_reference(lines: dict[str, ComparedLine]) -> None:
    assert [line.reference for line in lines.values()] == [None, "base", "base"]
    assert lines["base"].difference is None
    less = lines["w/o votes"].difference
    assert less is not None
    estimate = less.estimate
    assert (estimate.value, estimate.low, estimate.high) == pytest.approx((-0.1, -0.1, -0.1))
    assert (less.n_pairs, less.n_missing) == (4, 0)


def test_a_failed_scene_is_out_of_the_difference_and_counted(
    lines: dict[str, ComparedLine],
) -> None:
    other = lines["other"]
    assert other.difference is not None
    assert other.difference.estimate.value == pytest.approx((0.2 / 2 + 0.0) / 2)
    assert (other.difference.n_pairs, other.difference.n_missing) == (3, 1)
    assert (other.failed, other.n_missing) == (("attic",), 1)
    assert value(other.iou_3d) == pytest.approx((0.6 + 0.5) / 2)
    assert (lines["base"].failed, lines["base"].n_missing) == ((), 0)


def test_the_lowest_scene(lines: dict[str, ComparedLine]) -> None:
    assert lines["base"].lowest == ("kitchen", pytest.approx(0.5))
    assert lines["other"].lowest == ("garden", pytest.approx(0.5))


def test_places_are_shares_of_present_queries(lines: dict[str, ComparedLine]) -> None:
    # Of the kitchen's two one lies outside; the other scenes' only ones lie inside.
    assert value(lines["w/o votes"].within_radius) == pytest.approx((0.5 + 1 + 1) / 3)
    assert value(lines["base"].within_radius) == 1.0


def test_confidence_of_absent_objects(lines: dict[str, ComparedLine]) -> None:
    assert lines["base"].auroc == Estimate(1.0, 1.0, 1.0, 3)
    assert lines["w/o votes"].auroc == Estimate(0.0, 0.0, 0.0, 3)
    assert (lines["base"].n_refused, lines["base"].n_absent) == (3, 3)
    assert (lines["w/o votes"].n_refused, lines["w/o votes"].n_present_refused) == (0, 0)
    assert lines["w/o votes"].n_present == 4


def test_a_query_of_which_nothing_is_known_has_no_part_in_the_area() -> None:
    result, rows = make_run([scene_line("kitchen", "base", {"cup": 0.4}, present=0.3)])
    known = [r for r in rows if r.query != "cup"]
    (line,) = compare(result, rows, "rooms")
    assert value(line.auroc) == 0.0
    (line,) = compare(result, known, "rooms")
    assert line.auroc is None


def test_times_are_means_over_completed_scenes(lines: dict[str, ComparedLine]) -> None:
    assert lines["other"].prepare_seconds == 30.0
    assert lines["base"].query_seconds == 0.75


def test_a_line_that_failed_everywhere_has_no_numbers() -> None:
    failing = scene_line("kitchen", "other", {}, reference="base")[0].model_copy(
        update={"status": "failed", "error": "no masks", "queries": ()}
    )
    result, rows = make_run([scene_line("kitchen", "base", {"cup": 0.4}), (failing, [])])
    _, line = compare(result, rows, "rooms")
    assert line.iou_3d is None and line.difference is None and line.lowest is None
    assert line.auroc is None and line.prepare_seconds is None
    assert (line.failed, line.n_missing) == (("kitchen",), 1)


def test_missing_is_told_within_a_model_set() -> None:
    result, rows = make_run(
        [
            scene_line("kitchen", "base", {"cup": 0.4, "plate": 0.2}, "oracle"),
            scene_line("kitchen", "base", {"cup": 0.4}, "onboard"),
        ]
    )
    assert [line.n_missing for line in compare(result, rows, "rooms")] == [0, 0]
    (first,) = (line for line in compare(result, rows, "rooms") if line.model_set == "oracle")
    assert (first.name, first.label) == ("base · oracle", "base")


def test_rows_of_other_data_sets_and_absent_objects_do_not_count() -> None:
    result, rows = small_run()
    stray = [
        row("cup", SOLID, {"iou": 0.0}, method="base", dataset="halls"),
        row("unicorn", SOLID, {"iou": 0.0}, method="base", absent=True),
    ]
    assert compare(result, [*rows, *stray], "rooms") == compare(result, rows, "rooms")


def test_results_without_references_have_none(sample: Sample) -> None:
    result, rows, _ = sample
    assert not has_references(result)
    assert has_references(small_run()[0])
    assert {line.difference for line in compare(result, rows, "rooms")} == {None}
