"""Methods by name, their settings as parts of cache keys, and the same without each part."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from oracle_boxes import boxes
from pydantic import ValidationError

from gvr_core.errors import ConfigError
from gvr_core.methods import METHODS, MethodConfig, build_method, check_method, variants
from gvr_core.methods.gvr_paper import GVRPaper
from gvr_core.methods.gvr_robust import GVRRobust
from gvr_core.methods.lift import Lift
from gvr_core.models.registry import ModelConfig, build_models
from gvr_core.robust.config import (
    RobustConfig,
    RobustIndex,
    RobustLocate,
    RobustSegment,
)

SWITCHES = RobustConfig.switch_names()


def settings_of(method: str, **parts: Any) -> dict[str, Any]:
    return MethodConfig.model_validate({"method": method, **parts}).settings()


def changed(value: Any) -> Any:
    """Another value that the same setting takes."""
    if isinstance(value, bool):
        return not value
    return value + 1 if isinstance(value, int) else 0.37


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("gvr-paper", GVRPaper),
        ("random-patch", GVRPaper),
        ("gvr-robust", GVRRobust),
        ("lift", Lift),
    ],
)
def test_every_name_is_a_method(name: str, kind: type) -> None:
    assert name in METHODS and len(METHODS) == 4
    method = boxes().method(name)
    assert isinstance(method, kind) and method.name == name


def test_an_unknown_name_is_refused_with_those_that_are() -> None:
    tools = boxes().method().tools
    for refuse in (check_method, lambda name: build_method(MethodConfig(method=name), tools)):
        with pytest.raises(ConfigError) as error:
            refuse("gvr-papr")
        assert all(name in str(error.value) for name in ("gvr-papr", *METHODS))


def test_a_method_gets_its_own_settings() -> None:
    world = boxes()
    robust = world.method(robust={"bev_clip": False}, segment={"background": (0.2, 0.3, 0.4)})
    assert not robust.config.bev_clip and robust.background == (0.2, 0.3, 0.4)
    assert world.method("lift", lift={"threshold": 0.7}).config.threshold == 0.7
    paper = world.method("gvr-paper", locate={"rfl": False}, segment={"smfi": False})
    assert not paper.locating.rfl and not paper.segmenting.smfi


def test_the_control_draws_its_vectors_and_no_other_method_does() -> None:
    demanded = {name: MethodConfig(method=name).encoder_override for name in METHODS}
    name = demanded.pop("random-patch")
    assert set(demanded.values()) == {None}
    assert name is not None
    assert build_models(ModelConfig(encoder=name)).encoder.name.startswith("random/")


def test_the_shown_name_is_the_label_where_there_is_one() -> None:
    assert MethodConfig(method="lift").shown_name == "lift"
    assert MethodConfig(method="lift", label="mine").shown_name == "mine"
    for label in ("a·b", "tab\t", "x" * 65):
        with pytest.raises(ValidationError, match="label"):
            MethodConfig(label=label)


def test_switches_are_the_parts_that_are_on_or_off() -> None:
    on = RobustConfig().switches()
    assert on == SWITCHES and len(set(SWITCHES)) == len(SWITCHES) == 17
    assert SWITCHES[:2] == ("ground_up", "floaters") and SWITCHES[-1] == "cleanup"
    assert "phrases" not in SWITCHES  # None, True or False: a setting
    less = RobustConfig(ground_up=False, cleanup=False)
    assert less.switches() == SWITCHES[1:-1]
    assert RobustConfig(**dict.fromkeys(SWITCHES, False)).switches() == ()


@pytest.mark.parametrize(
    "wrong",
    [{"bev_clipp": True}, {"keep_at": 1.0}, {"ring_views": 0}, {"gate": 1.0}, {"neighbours": 0}],
)
def test_settings_that_are_none_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        RobustConfig.model_validate(wrong)


def test_the_steps_share_out_all_settings_and_none_twice() -> None:
    parts = [set(part.model_fields) for part in (RobustIndex, RobustLocate, RobustSegment)]
    assert set.union(*parts) == set(RobustConfig.model_fields)
    assert sum(map(len, parts)) == len(RobustConfig.model_fields)


@pytest.mark.parametrize("name", list(RobustConfig.model_fields))
def test_each_setting_of_gvr_robust_is_in_its_own_step_alone(name: str) -> None:
    plain = settings_of("gvr-robust")
    value = False if name == "phrases" else changed(getattr(RobustConfig(), name))
    other = settings_of("gvr-robust", robust={name: value})
    steps = {"index": RobustIndex, "locate": RobustLocate, "segment": RobustSegment}
    (own,) = [step for step, part in steps.items() if name in part.model_fields]
    assert {step for step in plain if plain[step] != other[step]} == {own}


def test_settings_of_other_methods_change_nothing() -> None:
    foreign: dict[str, dict[str, Any]] = {
        "gvr-paper": {"robust": {"bev_clip": False, "gate": 0.9}, "lift": {"threshold": 0.9}},
        "random-patch": {"robust": {"ground_up": False}, "lift": {"temperature": 3.0}},
        "gvr-robust": {
            "locate": {"top_k": 3},
            "segment": {"ring_views": 7},
            "lift": {"threshold": 0.9},
        },
        "lift": {"robust": {"cleanup": False}, "locate": {"top_k": 3}, "segment": {"smfi": False}},
    }
    assert set(foreign) == set(METHODS)
    for name, parts in foreign.items():
        assert settings_of(name, **parts) == settings_of(name)
        assert settings_of(name, label="renamed", leave_one_out=True) == settings_of(name)


def test_own_settings_change_the_step_that_reads_them() -> None:
    cases: list[tuple[str, dict[str, Any], set[str]]] = [
        ("gvr-paper", {"locate": {"top_k": 3}}, {"locate"}),
        # without retrieval the bird's-eye view is taken by text
        ("gvr-paper", {"locate": {"rfl": False}}, {"locate", "segment"}),
        ("gvr-paper", {"segment": {"ring_views": 5}}, {"segment"}),
        ("random-patch", {"segment": {"smfi": False}}, {"segment"}),
        ("lift", {"lift": {"threshold": 0.6}}, {"segment"}),
        ("lift", {"lift": {"temperature": 5.0}}, {"segment"}),
        ("lift", {"lift": {"share": 0.2}}, {"segment"}),
        ("lift", {"lift": {"phrases": True}}, {"segment"}),
    ]
    for name, parts, steps in cases:
        plain, other = settings_of(name), settings_of(name, **parts)
        assert {step for step in plain if plain[step] != other[step]} == steps


def test_the_colour_behind_renders_is_every_methods_own_entry() -> None:
    for name in METHODS:
        assert settings_of(name)["background"] == [0.0, 0.0, 0.0]
        white = settings_of(name, segment={"background": (1.0, 1.0, 1.0)})
        assert white["background"] == [1.0, 1.0, 1.0]


def test_a_method_alone_has_no_variants() -> None:
    for name in METHODS:
        config = MethodConfig(method=name, label="mine")
        assert variants(config) == (config,)
    config = MethodConfig(method="lift", leave_one_out=True)
    assert variants(config) == (MethodConfig(method="lift"),)


def test_each_switch_that_is_on_is_left_out_once() -> None:
    config = MethodConfig(
        method="gvr-robust", leave_one_out=True, robust={"bev_clip": False, "keep_at": 0.4}
    )
    base, *others = variants(config)
    assert base == config.model_copy(update={"leave_one_out": False})
    assert len(others) == len(SWITCHES) - 1
    for name, variant in zip([s for s in SWITCHES if s != "bev_clip"], others, strict=True):
        assert variant.label == f"w/o {name.replace('_', ' ')}"
        assert not variant.leave_one_out and variant.robust.keep_at == 0.4
        before, after = base.robust.model_dump(), variant.robust.model_dump()
        assert {key for key in before if before[key] != after[key]} == {name}


def test_the_paper_has_its_own_ablations() -> None:
    for name in ("gvr-paper", "random-patch"):
        base, no_rfl, no_smfi, neither = variants(
            MethodConfig(method=name, label="mine", leave_one_out=True, locate={"top_k": 4})
        )
        assert [v.label for v in (base, no_rfl, no_smfi, neither)] == [
            "mine",
            "mine w/o RFL",
            "mine w/o SMFI",
            "mine w/o RFL and SMFI",
        ]
        made = [(v.locate.rfl, v.segment.smfi) for v in (base, no_rfl, no_smfi, neither)]
        assert made == [(True, True), (False, True), (True, False), (False, False)]
        assert {v.locate.top_k for v in (base, no_rfl, no_smfi, neither)} == {4}
        assert {v.method for v in (base, no_rfl, no_smfi, neither)} == {name}


def test_variants_are_configurations_that_can_be_written_and_read() -> None:
    for name in METHODS:
        for variant in variants(MethodConfig(method=name, leave_one_out=True)):
            read = MethodConfig.model_validate_json(variant.model_dump_json())
            assert read == variant and read.settings() == variant.settings()


def test_the_arrays_of_an_index_are_named_by_the_method() -> None:
    world = boxes()
    books = world.method("gvr-paper").prepare(world.scene)
    assert books.index == {}
    robust = world.method().index(world.scene, books)
    assert {name: array.shape for name, array in robust.items()} == {
        "up": (3,),
        "steady": (len(world.scene.gaussians),),
    }
    assert np.linalg.norm(robust["up"]) == pytest.approx(1.0)
