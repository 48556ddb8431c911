from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mlflow.utils import validation
from record_samples import PLANE, REFUSAL, SOLID, Sample, row, scene_result

from reports.aggregate import aggregate
from reports.mlflow_content import run_contents
from reports.mlflow_run import Point, RunContent, finite, flatten, metric_name, safe_key, safe_value


@pytest.fixture
def contents(sample: Sample, tmp_path: Path) -> list[RunContent]:
    result, rows, _ = sample
    return run_contents(tmp_path, result, rows, aggregate(rows, result.scenes))


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=300))
def test_mlflow_takes_any_name_once_it_is_made_safe(name: str) -> None:
    key = safe_key(name)
    validation._validate_metric_name(key)
    validation._validate_param_name(key)
    validation._validate_tag_name(key)
    assert len(key) <= validation.MAX_ENTITY_KEY_LENGTH
    assert safe_key(key) == key


def test_good_names_stay_and_others_stay_apart() -> None:
    assert safe_key("acc_at_0.25") == "acc_at_0.25"
    assert safe_key("gvr.in_scene_2d/1/iou") == "gvr.in_scene_2d/1/iou"
    assert len({safe_key("a@b"), safe_key("a+b"), safe_key("a_b")}) == 3
    assert safe_key("x" * 300) != safe_key("x" * 301)


@settings(max_examples=100, deadline=None)
@given(st.one_of(st.text(max_size=9000), st.integers(), st.lists(st.text(max_size=3000))))
def test_values_fit(value: object) -> None:
    text = safe_value(value)
    assert 0 < len(text) <= min(validation.MAX_PARAM_VAL_LENGTH, validation.MAX_TAG_VAL_LENGTH)


def test_a_cut_value_says_so() -> None:
    assert safe_value("x" * 100) == "x" * 100
    assert safe_value("x" * 7000).endswith("(cut: the whole is in result.json)")


def test_metric_names_tell_protocols_apart() -> None:
    assert metric_name(PLANE, "iou") == "gvr.in_scene_2d/1/iou"
    assert metric_name(PLANE, "acc_at_0.25") == "gvr.in_scene_2d/1/acc_at_0.25"
    assert metric_name(SOLID, "iou") == "flags_3d/1/iou"
    assert metric_name(REFUSAL, "found") == "refusal/1/found"


def test_configuration_is_flat() -> None:
    config = {"a": {"b": 1, "c": {"d": [1, 2]}}, "e": {}, "f": None}
    flat = {"p.a.b": 1, "p.a.c.d": [1, 2], "p.e": {}, "p.f": None}
    assert dict(flatten(config, "p")) == flat


def test_what_is_not_finite_is_left_out_and_counted() -> None:
    points = [Point("a", 1.0), Point("b", math.nan), Point("c", math.inf), Point("d", -math.inf)]
    assert finite(points) == ((Point("a", 1.0),), 3)


def test_one_run_for_the_benchmark_and_one_for_each_scene_and_method(
    contents: list[RunContent],
) -> None:
    assert [content.tags["kind"] for content in contents] == ["benchmark", *["scene"] * 4]
    assert [content.failed for content in contents] == [True, False, False, False, True]


def test_the_parents_tags_stand_on_its_children(contents: list[RunContent]) -> None:
    parent, *children = contents
    own = {"kind", "mlflow.note.content"}
    shared = {key: value for key, value in parent.tags.items() if key not in own}
    assert {"gvr.run_id", "suite", "git_revision", "package.numpy"} <= set(shared)
    for child in children:
        assert shared.items() <= child.tags.items()


def test_an_absent_query_scores_nothing(contents: list[RunContent]) -> None:
    kitchen = contents[1]
    steps = {(p.key, p.step): p.value for p in kitchen.points if p.key.startswith("query/")}
    assert ("query/acc", 2) not in steps
    assert steps["query/found", 2] == 0.0
    assert steps["query/acc", 0] == 0.5
    assert steps["query/miou", 0] == pytest.approx(0.6)
    assert steps["query/iou_3d", 1] == 0.5


def test_names_of_summaries_do_not_collide(contents: list[RunContent]) -> None:
    for content in contents:
        keys = [(point.key, point.step) for point in content.points]
        assert len(keys) == len(set(keys))


def test_a_number_with_a_short_name_has_no_other_in_the_benchmark(
    contents: list[RunContent],
) -> None:
    keys = {point.key for point in contents[0].points}
    assert {"rooms/gvr-paper/miou", "rooms/gvr-paper/miou_class_macro"} <= keys
    assert "rooms/gvr-paper/flags_3d/1/recall" in keys
    assert "rooms/gvr-paper/flags_3d/1/recall_micro" not in keys
    assert not [key for key in keys if "gvr.in_scene_2d/1/iou" in key]
    table = contents[0].tables["summary.json"]
    assert "flags_3d/1/recall_micro" in table["columns"]


def test_what_people_look_for_comes_first(contents: list[RunContent]) -> None:
    parent, kitchen, *_ = contents
    assert [point.key for point in kitchen.points[:3]] == ["acc", "miou", "iou_3d"]
    assert next(iter(kitchen.tags)) == "kind"
    assert parent.name == "smoke 01-02 03:04"
    assert kitchen.name == "kitchen · gvr-paper"
    assert kitchen.tags["peak_memory_is_own"] == "false"
    assert kitchen.tags["revision"] == "01234567"


def test_a_foreign_protocol_gets_names_of_its_own(sample: Sample, tmp_path: Path) -> None:
    result, _, _ = sample
    rows = [
        row("cup", PLANE, {"iou": 0.25}, view="v1"),
        row("cup", "lerf_ovs/1", {"iou": 0.75}, view="v1"),
    ]
    result = result.model_copy(update={"scenes": (scene_result("kitchen", "gvr-paper", ["cup"]),)})
    parent, child = run_contents(tmp_path, result, rows, aggregate(rows))
    values = {point.key: point.value for point in child.points}
    assert (values["miou"], values["lerf_ovs/1/iou"]) == (0.25, 0.75)
    overall = {point.key: point.value for point in parent.points}
    assert overall["rooms/gvr-paper/miou"] == 0.25
    assert overall["rooms/gvr-paper/lerf_ovs/1/iou"] == 0.75
