"""Two runs compared: the numbers, the verdict, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from paper_samples import GG, GG_COMPAT, run
from report_samples import EVIL_TEXT, evil, make_result, written
from scipy.stats import binomtest
from test_html_report import Page

from gvr_core.errors import ConfigError
from reports.headline import overall_cell
from reports.html_compare import compare_page
from reports.record import Result, Row
from reports.result_check import ResultError
from reports.result_io import read_result
from reports.run_comparison import compare_runs, sign_test
from reports.run_comparison_json import as_json
from reports.run_comparison_sheets import changed, number_sheets

Run = tuple[Result, list[Row]]


def made(**options: object) -> Run:
    result, rows, _ = make_result(**options)  # type: ignore[arg-type]
    return result, rows


def with_iou(run: Run, query: str, value: float) -> Run:
    """The first method's IoU of one query, in every scene and view, set to a value."""
    result, rows = run
    return result, [
        r.model_copy(update={"metrics": {**r.metrics, "iou": value}})
        if (r.query, r.method) == (query, "gvr-paper") and "iou" in r.metrics
        else r
        for r in rows
    ]


def numbers(comparison, method: str = "gvr-paper") -> dict:
    return {n.column.key: n for n in comparison.numbers if n.method == method}


def test_a_run_is_the_same_as_itself() -> None:
    found = compare_runs(made(), made())
    assert len(found.numbers) == 6
    for number in found.numbers:
        estimate = number.difference.estimate
        assert (number.a, estimate.value, estimate.low, estimate.high) == (number.b, 0, 0, 0)
        assert number.sign.p is None and number.sign.n_same == 4
    assert not found.dropped(0.0) and not any(changed(found))


def test_differences_are_paired_and_clustered_by_scene() -> None:
    before = made(n_queries=5)
    found = compare_runs(before, with_iou(before, "thing-0", 0.9))
    miou = numbers(found)["miou"]
    # one query of four: from 0.1 to 0.9 in the kitchen, from 0.15 to 0.9 in the garden
    by_scene = [0.8 / 4, 0.75 / 4]
    assert miou.difference.estimate.value == pytest.approx(sum(by_scene) / 2)
    assert miou.difference.estimate.low == pytest.approx(min(by_scene))
    assert miou.difference.estimate.high == pytest.approx(max(by_scene))
    assert miou.b - miou.a == pytest.approx(sum(by_scene) / 2)
    assert miou.difference.n_pairs == 16 and miou.difference.estimate.n_scenes == 2
    assert (miou.sign.n_better, miou.sign.n_worse, miou.sign.n_same) == (2, 0, 6)
    assert numbers(found, "w/o RFL")["miou"].difference.estimate.value == 0
    worse, better = changed(found)
    assert not worse and [(q.scene, q.query) for q in better] == [
        ("kitchen", "thing-0"),
        ("garden", "thing-0"),
    ]


def test_headline_numbers_are_those_of_the_table() -> None:
    from reports.aggregate import aggregate

    before, after = made(n_queries=6), made(n_queries=6, shift=-0.07)
    found = compare_runs(before, after)
    for number in found.numbers:
        for (result, rows), value in ((before, number.a), (after, number.b)):
            summary = aggregate(rows, result.scenes)
            cell = overall_cell(result, summary, "rooms", number.method, number.column)
            assert value == pytest.approx(cell.value)


def test_a_protocol_that_averages_over_classes_is_compared_as_it_averages() -> None:
    def uneven(first: float) -> Run:
        """One target under two wordings, and another under one."""
        scores = {"x": {s: [(0.5, first), (0.5, 0.2), (0.5, 0.6)] for s in ("ramen", "teatime")}}
        result, rows = run(scores, "lerf_mask", GG, "boundary_iou")
        target = {"q0": "cup", "q1": "cup", "q2": "plate"}
        return result, [r.model_copy(update={"target": target[r.query]}) for r in rows]

    found = compare_runs(uneven(0.4), uneven(0.8))
    (iou,) = [n for n in found.numbers if n.column.metric == "iou"]
    assert (iou.a, iou.b) == (pytest.approx(0.45), pytest.approx(0.55))
    assert iou.difference.estimate.value == pytest.approx(0.1)


def test_the_sign_test_is_exact() -> None:
    assert sign_test([0.1] * 9 + [-0.1]).p == pytest.approx(binomtest(9, 10).pvalue)
    assert sign_test([0.1, 0.0, 1e-12]).n_same == 2
    assert sign_test([0.0, 0.0]).p is None


@pytest.mark.parametrize(
    ("shift", "points", "fails"),
    [(-0.02, 1.0, True), (-0.02, 2.0, False), (-0.02, 1.99, True), (0.3, 0.0, False)],
)
def test_a_drop_is_one_beyond_the_points(shift, points, fails) -> None:
    before = made(scenes=("kitchen",), methods=("gvr-paper",), n_queries=3, shift=0.3)
    found = compare_runs(before, made(
        scenes=("kitchen",), methods=("gvr-paper",), n_queries=3, shift=0.3 + shift
    ))  # fmt: skip
    dropped = found.dropped(points)
    assert bool(dropped) is fails
    if fails:
        assert {n.column.key for n in dropped} == {"miou", "iou_3d"}
        assert all(n.drop == pytest.approx(2.0) for n in dropped)


def refusal(a: Run, b: Run) -> str:
    with pytest.raises(ResultError) as caught:
        compare_runs(a, b)
    return str(caught.value)


def test_other_queries_are_refused_by_name_and_the_common_ones_compared_when_asked() -> None:
    a, b = made(n_queries=3), made(n_queries=4)
    # the last query of each is absent, so thing-2 is absent in A and present in B
    text = refusal(a, b)
    assert "2 queries only in B (kitchen/thing-3, garden/thing-3)" in text
    assert "2 queries with another text or target (kitchen/thing-2, garden/thing-2)" in text
    assert "--common" in text
    found = compare_runs(a, b, common=True)
    assert {q.query for q in found.queries} == {"thing-0", "thing-1"}
    assert all(n.a == n.b for n in found.numbers)
    assert any("only in B" in said for said in found.left_out)


def test_another_wording_is_another_query() -> None:
    text = refusal(made(), made(texts={"thing-1": "something else"}))
    assert "2 queries with another text or target" in text and "thing-1" in text


def test_a_view_that_one_lacks_is_named() -> None:
    result, rows = made()
    gone = next(r for r in rows if r.view == "v2")
    fewer = [r for r in rows if r is not gone]
    text = refusal((result, rows), (result, fewer))
    assert "2 scores only in A (kitchen/thing-0 in v2)" in text
    found = compare_runs((result, rows), (result, fewer), common=True)
    assert numbers(found)["miou"].difference.n_pairs == 7


def test_a_scene_that_failed_is_named() -> None:
    text = refusal(made(), made(failed=("garden", "gvr-paper")))
    assert "rooms · gvr-paper: failed in B on garden" in text
    assert "3 queries only in A" in text


def test_lines_that_one_lacks_are_named_and_one_can_be_chosen() -> None:
    a, b = made(methods=("gvr-paper",)), made()
    assert "rooms · w/o RFL only in B" in refusal(a, b)
    found = compare_runs(a, b, methods=["gvr-paper"])
    assert {n.method for n in found.numbers} == {"gvr-paper"} and not found.left_out
    with pytest.raises(ConfigError, match=r"unknown method 'nothing'.*gvr-paper"):
        compare_runs(a, b, methods=["nothing"])
    with pytest.raises(ResultError, match="no line in common"):
        compare_runs(a, made(methods=("other",)), common=True)


@pytest.mark.parametrize("common", [False, True])
def test_numbers_of_two_protocols_are_never_compared(common) -> None:
    scores = {"x": {"ramen": [(0.5, 0.5)], "teatime": [(0.5, 0.6)]}}
    a = run(scores, "lerf_mask", GG, "boundary_iou")
    b = run(scores, "lerf_mask", GG_COMPAT, "boundary_iou")
    with pytest.raises(ResultError) as caught:
        compare_runs(a, b, common=common)
    assert GG in str(caught.value) and GG_COMPAT in str(caught.value)


def test_other_data_and_models_are_noted() -> None:
    result, rows = made()
    scenes = [
        s.model_copy(update={"digests": {"gaussians": "b" * 64}, "models": {"encoder": "clip/1"}})
        for s in result.scenes
    ]
    found = compare_runs((result, rows), (result.model_copy(update={"scenes": scenes}), rows))
    assert any("data: gaussians in rooms/garden, rooms/kitchen" in n for n in found.notes)
    assert any("models: encoder" in n for n in found.notes)


def test_json_has_every_number() -> None:
    before = made(n_queries=5)
    found = compare_runs(before, with_iou(before, "thing-3", 0.0))
    content = json.loads(json.dumps(as_json(found, 1.0), allow_nan=False))
    assert len(content["numbers"]) == 6 and len(content["queries"]) == 16
    (miou,) = [n for n in content["numbers"] if (n["method"], n["title"]) == ("gvr-paper", "mIoU")]
    assert miou["drop"] == pytest.approx(100 * (miou["a"] - miou["b"])) and miou["worse"] == 2
    assert {n["title"] for n in content["dropped"]} == {"mIoU", "3D IoU"}


def test_sheets_name_protocols_and_what_is_drawn_anew() -> None:
    (sheet,) = number_sheets(compare_runs(made(), made(shift=0.05)))
    text = " ".join(sheet.notes)
    assert "iou of gvr.in_scene_2d/1" in text and "bootstrap over the 2 scenes" in text
    assert "not independent" in text
    assert sheet.rows[1][:5] == ("gvr-paper", "mIoU", "17.5", "22.5", "+5.0 (+5.0, +5.0)")


def test_the_page_shows_both_answers_and_keeps_names_names(tmp_path: Path) -> None:
    folders = evil(tmp_path / "a"), evil(tmp_path / "b")
    a, (result, rows) = (read_result(folder) for folder in folders)
    worse = with_iou((result, rows), "thing-0", 0.0)
    text = compare_page(compare_runs(a, worse), folders, 1.0)
    page = Page(text)
    assert "headline numbers dropped by more than 1.0 points" in text
    assert all(not any(n.startswith("on") for n in attributes) for _, attributes in page.tags)
    assert [a.get("type") for t, a in page.tags if t == "script"] == [None]
    cells = {cell for table in page.tables for line in table for cell in line}
    assert EVIL_TEXT in cells
    images = [attributes for tag, attributes in page.tags if tag == "img"]
    assert images and all(a["loading"] == "lazy" for a in images)
    assert all(str(a["src"]).startswith("data:image/webp;base64,") for a in images)
    assert len({a["alt"] for a in images}) == 2, "the answers of A and of B"


def test_pictures_of_results_without_evidence_serve_too(tmp_path, result_folder) -> None:
    run_ = read_result(result_folder)
    result, rows = run_
    lower = [
        r.model_copy(update={"metrics": {**r.metrics, "iou": 0.0}})
        if r.query == "cup" and "iou" in r.metrics
        else r
        for r in rows
    ]
    page = Page(compare_page(compare_runs(run_, (result, lower)), (result_folder, result_folder)))
    assert [tag for tag, _ in page.tags].count("img") == 4, "two lines, two runs"


def test_written_results_are_read_again(tmp_path: Path) -> None:
    folder = written(tmp_path)
    found = compare_runs(read_result(folder), read_result(folder))
    assert found.a.run_id == folder.name
