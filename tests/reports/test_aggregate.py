from __future__ import annotations

import random
from statistics import fmean

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from record_samples import PLANE, REFUSAL, SOLID, Sample, row

from reports.aggregate import Aggregate, aggregate
from reports.record import Row


@pytest.fixture
def summary(sample: Sample) -> Aggregate:
    result, rows, _ = sample
    return aggregate(rows, result.scenes)


def test_flat_mean_over_queries_and_views(summary: Aggregate) -> None:
    kitchen = summary.scene("rooms", "kitchen", "gvr-paper", PLANE)
    assert kitchen is not None
    assert kitchen.metrics["acc_peak"].mean == pytest.approx(2 / 3)
    assert kitchen.metrics["iou"].mean == pytest.approx(0.6)
    assert kitchen.metrics["iou"].n == 3


def test_class_macro_weighs_targets_alike(summary: Aggregate) -> None:
    kitchen = summary.scene("rooms", "kitchen", "gvr-paper", PLANE)
    assert kitchen is not None
    acc = kitchen.metrics["acc_peak"]
    assert (acc.class_macro, acc.n_classes) == (pytest.approx((0.5 + 1.0) / 2), 2)


def test_overall_is_scene_macro_and_micro_stands_beside(summary: Aggregate) -> None:
    overall = summary.overall("rooms", "gvr-paper", PLANE)
    assert overall is not None
    assert overall.metrics["iou"].scene_macro == pytest.approx((0.6 + 0.2) / 2)
    assert overall.metrics["iou"].micro == pytest.approx((0.8 + 0.4 + 0.6 + 0.2) / 4)
    assert (overall.scenes, overall.missing) == (("kitchen", "garden"), ())


def test_protocols_do_not_mix(summary: Aggregate) -> None:
    flags = summary.scene("rooms", "kitchen", "gvr-paper", SOLID)
    assert flags is not None
    assert flags.metrics["iou"].mean == pytest.approx(0.6)
    assert flags.metrics["iou"].n == 2
    assert "acc_peak" not in flags.metrics


def test_undefined_is_counted_not_averaged(summary: Aggregate) -> None:
    flags = summary.scene("rooms", "kitchen", "gvr-paper", SOLID)
    assert flags is not None
    error = flags.metrics["location_error"]
    assert (error.mean, error.n, error.n_undefined, error.coverage) == (0.1, 1, 1, 0.5)


def test_failed_scene_is_missing(summary: Aggregate) -> None:
    overall = summary.overall("rooms", "lift", PLANE)
    assert overall is not None
    assert overall.missing == ("garden",)
    assert overall.metrics["iou"].n_scenes == 1


def test_absent_objects_count_in_refusals_alone(sample: Sample) -> None:
    result, rows, _ = sample
    stray = row("unicorn", PLANE, {"iou": 0.0, "acc_peak": 0.0}, view="v1", absent=True)
    summary = aggregate([*rows, stray], result.scenes)
    kitchen = summary.scene("rooms", "kitchen", "gvr-paper", PLANE)
    assert kitchen is not None
    assert (kitchen.n_rows, kitchen.n_absent) == (4, 1)
    assert kitchen.metrics["iou"].mean == pytest.approx(0.6)
    assert kitchen.metrics["iou"].coverage == 1.0
    correct = summary.scene("rooms", "kitchen", "gvr-paper", REFUSAL)
    assert correct is not None and correct.metrics["correct"].n == 3
    refusal = summary.refusal("rooms", "kitchen", "gvr-paper")
    assert refusal is not None
    assert (refusal.n_absent, refusal.n_refused) == (1, 1)
    assert (refusal.n_present, refusal.n_present_refused) == (2, 0)


def test_a_method_that_skips_pairs_shows_in_coverage(sample: Sample) -> None:
    _, rows, _ = sample
    skipped = [r for r in rows if (r.method, r.view, r.query) != ("lift", "v2", "cup")]
    lift = aggregate(skipped).scene("rooms", "kitchen", "lift", PLANE)
    whole = aggregate(skipped).scene("rooms", "kitchen", "gvr-paper", PLANE)
    assert lift is not None and whole is not None
    assert lift.metrics["iou"].coverage == pytest.approx(2 / 3)
    assert whole.metrics["iou"].coverage == 1.0


def test_pairs_that_nobody_can_score_are_not_expected(sample: Sample) -> None:
    _, rows, _ = sample
    summary = aggregate([*rows, row("plate", PLANE, {}, view="v2")])
    kitchen = summary.scene("rooms", "kitchen", "gvr-paper", PLANE)
    assert kitchen is not None
    iou = kitchen.metrics["iou"]
    assert (iou.n, iou.n_undefined, iou.coverage) == (3, 1, 1.0)


def test_nothing() -> None:
    assert aggregate([]) == Aggregate(scenes=(), datasets=(), refusals=())


names = st.sampled_from(["a", "b", "c"])
values = st.floats(-1e6, 1e6)
some_rows = st.lists(
    st.tuples(names, names, names, st.booleans(), st.dictionaries(names, values, max_size=3)),
    max_size=40,
)


def build(content: list[tuple[str, str, str, bool, dict[str, float]]]) -> list[Row]:
    return [
        row(query, protocol, metrics, scene=scene, absent=absent, view=str(i))
        for i, (scene, query, protocol, absent, metrics) in enumerate(content)
    ]


@settings(max_examples=100, deadline=None)
@given(some_rows)
def test_against_plain_python(content: list[tuple[str, str, str, bool, dict[str, float]]]) -> None:
    summary = aggregate(build(content))
    for metric in "abc":
        for protocol in "abc":
            by_scene: dict[str, list[tuple[str, float]]] = {}
            for scene, query, its_protocol, absent, metrics in content:
                if its_protocol == protocol and not absent and metric in metrics:
                    by_scene.setdefault(scene, []).append((query, metrics[metric]))
            for scene in "abc":
                found = summary.scene("rooms", scene, "gvr-paper", protocol)
                mean = None if found is None else found.metrics.get(metric)
                pairs = by_scene.get(scene)
                if pairs is None:
                    assert mean is None
                    continue
                assert mean is not None
                assert mean.mean == pytest.approx(fmean(v for _, v in pairs), abs=1e-6)
                classes = [
                    fmean(v for q, v in pairs if q == query) for query in {q for q, _ in pairs}
                ]
                assert mean.class_macro == pytest.approx(fmean(classes), abs=1e-6)
                assert mean.n == len(pairs)
            overall = summary.overall("rooms", "gvr-paper", protocol)
            total = None if overall is None else overall.metrics.get(metric)
            if not by_scene:
                assert total is None
                continue
            assert total is not None
            scene_means = [fmean(v for _, v in pairs) for pairs in by_scene.values()]
            everything = [v for pairs in by_scene.values() for _, v in pairs]
            assert total.scene_macro == pytest.approx(fmean(scene_means), abs=1e-6)
            assert total.micro == pytest.approx(fmean(everything), abs=1e-6)
            assert (total.n, total.n_scenes) == (len(everything), len(by_scene))


@settings(max_examples=50, deadline=None)
@given(some_rows, st.randoms(use_true_random=False))
def test_order_of_rows_does_not_matter(
    content: list[tuple[str, str, str, bool, dict[str, float]]], order: random.Random
) -> None:
    rows = build(content)
    shuffled = rows.copy()
    order.shuffle(shuffled)
    first, second = aggregate(rows), aggregate(shuffled)
    for part in first.scenes:
        other = second.scene(part.dataset, part.scene, part.method, part.protocol)
        assert other is not None
        assert {k: v.mean for k, v in other.metrics.items()} == {
            k: v.mean for k, v in part.metrics.items()
        }
