"""All protocols by id, ours among them, and what each of them refuses."""

from __future__ import annotations

import dataclasses

import numpy as np
import protocol_cases as cases
import protocol_twins as twins
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gvr_core.protocols
from gvr_core.errors import ConfigError, DatasetError
from gvr_core.metrics import FLAGS_3D, IN_SCENE_2D, REFUSAL, flags_3d, in_scene_2d, refusal
from gvr_core.protocols import PROTOCOLS, protocol
from gvr_core.protocols.base import Metrics, ProtocolSpec, ViewPrediction, ViewTruth

OF_VIEWS = [spec for spec in PROTOCOLS.values() if spec.score_pair or spec.score_view]


def score(spec: ProtocolSpec, prediction: ViewPrediction, truth: ViewTruth) -> Metrics | None:
    if spec.score_pair is not None:
        return spec.score_pair(prediction, truth)
    assert spec.score_view is not None
    return spec.score_view({"it": prediction}, {"it": truth})["it"]


def test_the_ids() -> None:
    assert set(PROTOCOLS) == {
        "gvr.in_scene_2d/1",
        "flags_3d/1",
        "refusal/1",
        "lerf_ovs.langsplat_2d/1",
        "lerf_ovs.opengaussian_3d/1",
        "lerf_mask.gg/1",
        "lerf_mask.gg_compat/1",
        "ovs3d.binary/1",
        "ovs3d.exclusive/1",
    }
    for name, spec in PROTOCOLS.items():
        assert protocol(name) is spec
        assert spec.id == name
        assert protocol(name.partition("/")[0]) is spec
        assert None in (spec.score_pair, spec.score_view)
    assert {name for name in PROTOCOLS if PROTOCOLS[name] not in OF_VIEWS} == {FLAGS_3D, REFUSAL}


def test_without_a_version_the_newest(monkeypatch: pytest.MonkeyPatch) -> None:
    first = protocol("ovs3d.binary/1")
    newer = {
        f"ovs3d.binary/{n}": dataclasses.replace(first, id=f"ovs3d.binary/{n}") for n in (9, 10)
    }
    monkeypatch.setattr(gvr_core.protocols, "PROTOCOLS", {**newer, **PROTOCOLS})
    assert protocol("ovs3d.binary").id == "ovs3d.binary/10"
    assert protocol("ovs3d.binary/1") is first


@pytest.mark.parametrize("name", ["", "lerf_ovs", "lerf_ovs.langsplat_2d/2", "ovs3d.binary/", "/1"])
def test_an_unknown_id_lists_those_that_are_known(name: str) -> None:
    with pytest.raises(ConfigError) as caught:
        protocol(name)
    assert repr(name) in str(caught.value)
    assert all(known in str(caught.value) for known in PROTOCOLS)


@pytest.mark.parametrize("spec", OF_VIEWS, ids=lambda spec: spec.id)
def test_what_is_shown_is_scored_and_within_bounds(spec: ProtocolSpec) -> None:
    rng = np.random.default_rng(1)
    seen = set()
    for _ in range(40):
        prediction, truth = cases.pair(rng, (31, 29))
        before = prediction.soft.copy(), truth.mask.copy()
        values = score(spec, prediction, truth)
        assert np.array_equal(prediction.soft, before[0])
        assert np.array_equal(truth.mask, before[1])
        for name, value in (values or {}).items():
            assert type(value) is float
            assert 0 <= value <= 1
            seen.add(name)
    assert seen >= {metric for metric, _ in spec.headline}


def test_what_is_shown_of_the_others_is_scored() -> None:
    flags = np.array([True, False])
    values = flags_3d(flags, flags, np.zeros((2, 3), np.float32), None)
    assert {metric for metric, _ in protocol(FLAGS_3D).headline} <= set(values)
    assert {metric for metric, _ in protocol(REFUSAL).headline} <= set(refusal(True, False))


@pytest.mark.parametrize("spec", OF_VIEWS, ids=lambda spec: spec.id)
def test_maps_that_cannot_be_scored_are_refused(spec: ProtocolSpec) -> None:
    size = (9, 7)
    good = np.zeros(size, np.float32)
    truth = ViewTruth(np.ones(size, np.bool_), ())
    bad = good.copy()
    bad[3, 3] = np.nan
    turned = np.zeros(size[::-1], np.float32)
    for prediction, said in (
        (ViewPrediction(turned), "soft.*shape"),
        (ViewPrediction(bad), "soft.*not a number"),
        (ViewPrediction(good, isolated=turned), "isolated.*shape"),
        (ViewPrediction(good, isolated=bad), "isolated.*not a number"),
        (ViewPrediction(good, relevancy=good), "relevancy.*shape"),
        (ViewPrediction(good, relevancy=turned[None]), "relevancy.*shape"),
        (ViewPrediction(good, relevancy=np.zeros((0, *size), np.float32)), "relevancy.*shape"),
        (ViewPrediction(good, relevancy=np.stack([good, bad])), "relevancy.*not a number"),
    ):
        with pytest.raises(DatasetError, match=said):
            score(spec, prediction, truth)
    empty = np.zeros((0, 7), np.float32)
    for mask in (good, np.zeros(9, np.bool_), empty > 0):
        with pytest.raises(DatasetError, match="mask"):
            score(spec, ViewPrediction(np.zeros(mask.shape, np.float32)), ViewTruth(mask, ()))


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(cases.SIZES))
def test_ours_equals_its_twin(seed: int, size: tuple[int, int]) -> None:
    pair = cases.pair(np.random.default_rng(seed), size)
    values, expected = score(protocol(IN_SCENE_2D), *pair), twins.in_scene_2d(*pair)
    assert (values is None) == (expected is None)
    assert values is None or values == pytest.approx(expected, abs=1e-9)


def test_ours_takes_the_box_of_the_mask() -> None:
    mask = np.zeros((60, 60), np.bool_)
    mask[10:50, 10:50] = True
    soft = mask.astype(np.float32)
    for boxes in ((), ((0.0, 0.0, 1.0, 1.0),)):
        values = score(protocol(IN_SCENE_2D), ViewPrediction(soft), ViewTruth(mask, boxes))
        assert values == in_scene_2d(soft, mask, None)
        assert values["acc_peak"] == 1
