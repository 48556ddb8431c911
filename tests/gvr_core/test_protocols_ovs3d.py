"""The protocols of 3D-OVS against their twins, and what they promise."""

from __future__ import annotations

import numpy as np
import protocol_cases as cases
import protocol_twins as twins
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gvr_core.errors import DatasetError
from gvr_core.protocols import protocol
from gvr_core.protocols.base import ViewPrediction, ViewTruth
from gvr_core.protocols.ovs3d import binary, exclusive

SEEDS = st.integers(0, 2**32 - 1)
SIZES = st.sampled_from(cases.SIZES)
CLASSES = ("wood wall", "Pikachu", "a red bag", "UNO cards")

View = tuple[dict[str, ViewPrediction], dict[str, ViewTruth]]


def random_view(seed: int, size: tuple[int, int], count: int, *, ties: bool = True) -> View:
    """Soft maps and masks of some classes; masks overlap and leave pixels without a class."""
    rng = np.random.default_rng(seed)
    predictions, truths = {}, {}
    for name in CLASSES[:count]:
        prediction, truths[name] = cases.pair(rng, size)
        soft = prediction.soft if ties else rng.random(size).astype(np.float32)
        predictions[name] = ViewPrediction(soft)
    return predictions, truths


def view_of(softs: dict[str, list[float]], masks: dict[str, list[int]]) -> View:
    return (
        {name: ViewPrediction(np.array([row], np.float32)) for name, row in softs.items()},
        {name: ViewTruth(np.array([row], np.bool_), ()) for name, row in masks.items()},
    )


@settings(max_examples=150, deadline=None)
@given(SEEDS, SIZES)
def test_binary_equals_its_twin(seed: int, size: tuple[int, int]) -> None:
    pair = cases.pair(np.random.default_rng(seed), size)
    values, expected = binary(*pair), twins.binary(*pair)
    assert (values is None) == (expected is None)
    assert values is None or values == pytest.approx(expected, abs=1e-9)


@settings(max_examples=100, deadline=None)
@given(SEEDS, SIZES, st.integers(1, 4))
def test_exclusive_equals_its_twin(seed: int, size: tuple[int, int], count: int) -> None:
    view = random_view(seed, size, count)
    values, expected = exclusive(*view), twins.exclusive(*view)
    assert values.keys() == expected.keys()
    for name in values:
        assert values[name] == pytest.approx(expected[name], abs=1e-9)


def test_a_full_picture_equals_its_twin() -> None:
    rng = np.random.default_rng(6)
    softs = {name: cases.blobs(rng, cases.FULL).astype(np.float32) for name in CLASSES}
    best = np.argmax(np.stack([softs[name] for name in CLASSES]), axis=0)
    noisy = np.where(rng.random(cases.FULL) < 0.8, best, -1)
    predictions = {name: ViewPrediction(soft) for name, soft in softs.items()}
    truths = {name: ViewTruth(noisy == i, ()) for i, name in enumerate(CLASSES)}
    expected = twins.exclusive(predictions, truths)
    values = exclusive(predictions, truths)
    for name in CLASSES:
        assert values[name] == pytest.approx(expected[name], abs=1e-9)
        assert expected[name]["iou"] > 0.7
    alone = predictions[name], truths[name]
    assert binary(*alone) == pytest.approx(twins.binary(*alone), abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(SEEDS, SIZES)
def test_truth_and_prediction_may_change_places(seed: int, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    a, b = cases.mask(rng, size), cases.mask(rng, size)
    one = binary(ViewPrediction(a.astype(np.float32)), ViewTruth(b, ()))
    assert one == binary(ViewPrediction(b.astype(np.float32)), ViewTruth(a, ()))
    assert one is None or 0 <= one["iou"] <= 1


@settings(max_examples=60, deadline=None)
@given(SEEDS, SIZES, st.permutations(CLASSES))
def test_other_names_in_another_order_give_the_same(
    seed: int, size: tuple[int, int], order: list[str]
) -> None:
    """Without ties, names do not matter, nor does the order in which classes are handed over."""
    predictions, truths = random_view(seed, size, 4, ties=False)
    values = exclusive(predictions, truths)
    renamed = dict(zip(CLASSES, order, strict=True))
    again = exclusive(
        {renamed[name]: predictions[name] for name in reversed(CLASSES)},
        {renamed[name]: truths[name] for name in CLASSES},
    )
    assert {renamed[name]: values[name] for name in CLASSES} == again


@settings(max_examples=60, deadline=None)
@given(SEEDS, SIZES, st.sampled_from((np.flipud, np.fliplr, np.transpose)))
def test_turned_pictures_give_the_same(seed: int, size: tuple[int, int], turn: object) -> None:
    assert callable(turn)
    predictions, truths = random_view(seed, size, 3)
    turned = exclusive(
        {name: ViewPrediction(turn(p.soft)) for name, p in predictions.items()},
        {name: ViewTruth(turn(t.mask), ()) for name, t in truths.items()},
    )
    assert turned == exclusive(predictions, truths)


def test_equal_scores_go_to_the_class_that_sorts_first() -> None:
    view = view_of(
        {"b": [0.4, 0.4, 0.0, 0.6], "a": [0.4, 0.3, 0.0, 0.4], "C": [0.4, 0.4, 0.0, 0.6]},
        {"b": [0, 0, 0, 0], "a": [0, 1, 0, 0], "C": [1, 1, 1, 1]},
    )
    values = exclusive(*view)  # capital letters sort first: C takes all four
    assert values["C"] == {"iou": 1.0, "pixel_acc": 0.75}  # the second pixel has two labels
    assert values["a"]["iou"] == values["b"]["iou"] == 0


def test_pixels_with_no_label_or_several_are_always_wrong() -> None:
    softs = {"a": [1.0, 1.0, 1.0, 0.0], "b": [0.0, 0.0, 0.0, 1.0]}
    values = exclusive(*view_of(softs, {"a": [1, 1, 0, 0], "b": [0, 1, 0, 1]}))
    assert values["a"]["pixel_acc"] == values["b"]["pixel_acc"] == 0.5
    assert values["a"]["iou"] == pytest.approx(2 / 3)
    assert values["b"]["iou"] == 0.5
    assert exclusive(*view_of(softs, {"a": [1, 1, 1, 0], "b": [0, 0, 0, 1]})) == {
        "a": {"iou": 1, "pixel_acc": 1},
        "b": {"iou": 1, "pixel_acc": 1},
    }
    unlabelled = exclusive(*view_of(softs, {"a": [0] * 4, "b": [0] * 4}))
    assert unlabelled["a"] == {"iou": 0, "pixel_acc": 0}


def test_the_mean_over_classes_is_the_mean_over_pictures() -> None:
    """The source averages accuracies over pictures; here each stands once for each class."""
    views = [random_view(seed, (12, 9), 3) for seed in range(5)]
    rows = [values["pixel_acc"] for view in views for values in exclusive(*view).values() if values]
    pictures = [twins.exclusive(*view)[CLASSES[0]]["pixel_acc"] for view in views]
    assert np.mean(rows) == pytest.approx(np.mean(pictures), abs=1e-12)


def test_a_class_that_is_nowhere_scores_zero_among_rivals_and_nothing_alone() -> None:
    view = view_of({"a": [1.0, 1.0], "b": [0.0, 0.0]}, {"a": [1, 1], "b": [0, 0]})
    assert exclusive(*view)["b"]["iou"] == 0
    assert binary(view[0]["b"], view[1]["b"]) is None


def test_empty_masks() -> None:
    nothing, something = np.zeros((5, 6), np.bool_), np.ones((5, 6), np.bool_)
    zero = {"iou": 0.0}
    assert binary(ViewPrediction(nothing.astype(np.float32)), ViewTruth(something, ())) == zero
    assert binary(ViewPrediction(something.astype(np.float32)), ViewTruth(nothing, ())) == zero
    missing = ViewPrediction(nothing.astype(np.float32), missing=True)
    assert binary(missing, ViewTruth(something, ())) == zero
    assert exclusive({}, {}) == {}


def test_half_is_not_above_half() -> None:
    half = ViewPrediction(np.full((3, 3), 0.5, np.float32))
    assert binary(half, ViewTruth(np.ones((3, 3), np.bool_), ())) == {"iou": 0}


def test_classes_must_be_the_same() -> None:
    predictions, truths = random_view(1, (7, 5), 3)
    with pytest.raises(DatasetError, match="labelled classes Pikachu, a red bag, wood wall"):
        exclusive({**predictions, "sofa": predictions["Pikachu"]}, truths)
    del predictions["Pikachu"]
    with pytest.raises(DatasetError, match="labelled classes Pikachu"):
        exclusive(predictions, truths)
    with pytest.raises(DatasetError, match="several sizes"):
        one, other = random_view(1, (7, 5), 1), random_view(1, (5, 7), 2)
        exclusive(
            {"wood wall": one[0]["wood wall"], "Pikachu": other[0]["Pikachu"]},
            {"wood wall": one[1]["wood wall"], "Pikachu": other[1]["Pikachu"]},
        )


def test_how_they_are_averaged_and_shown() -> None:
    alone, rivals = protocol("ovs3d.binary/1"), protocol("ovs3d.exclusive/1")
    assert (alone.mean, rivals.mean) == ("flat", "flat")
    assert alone.headline == (("iou", "mIoU"),)
    assert [metric for metric, _ in rivals.headline] == ["iou", "pixel_acc"]
    assert alone.score_pair is binary
    assert rivals.score_view is exclusive
