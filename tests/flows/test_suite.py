"""Suites: what is accepted, and how a mistake is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from flows.suite import (
    DatasetChoice,
    SuiteConfig,
    bundled_suites,
    override,
    parse_suite,
    read_suite,
)
from gvr_core.errors import ConfigError

GOOD = """
name = "mine"
[[datasets]]
name = "gallery"
scenes = ["gallery_0"]
[[methods]]
method = "gvr-paper"
locate = { top_k = 5 }
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", sorted(bundled_suites()))
def test_bundled_suites_are_valid(name: str) -> None:
    assert read_suite(name).name == name


def test_a_suite_of_ones_own(tmp_path: Path) -> None:
    suite = read_suite(str(write(tmp_path, GOOD)))
    assert suite.datasets[0].scenes == ("gallery_0",)
    assert suite.methods[0].locate.top_k == 5
    assert suite.methods[0].segment.ring_views == 4
    assert [models.encoder for models in suite.models] == ["onboard-conse"]


@pytest.mark.parametrize(
    ("change", "found", "accepted"),
    [
        (('name = "gallery"', 'name = "galery"'), "galery", "gallery"),
        (('method = "gvr-paper"', 'method = "gvr"'), "gvr", "gvr-paper"),
        (("top_k = 5", "top_kk = 5"), "methods.0.locate.top_kk", "top_k"),
        (("top_k = 5", "top_k = 0"), "methods.0.locate.top_k", None),
        (('name = "mine"', 'name = "mine"\nspeed = 3'), "speed", "renderer"),
        (('name = "mine"', 'name = "mine"\nrenderer = "cuda"'), "cuda", "numba"),
        (
            ('name = "mine"', 'name = "mine"\nmodels = { encoder = "clip" }'),
            "clip",
            "onboard-conse",
        ),
        (
            ('name = "mine"', 'name = "mine"\nmodels = { encode = "x" }'),
            "models.encode:",
            "encoder",
        ),
        (("[[datasets]]", "[[models]]\n[[models]]\n[[datasets]]"), "2 sets of models", "label"),
        (
            ("[[datasets]]", '[[models]]\nlabel = "a"\nencode = "x"\n[[datasets]]'),
            "models.0.encode",
            "encoder",
        ),
        (
            ("[[datasets]]", '[[models]]\nlabel = "a"\n[[models]]\nlabel = "a"\n[[datasets]]'),
            "'a', 'a'",
            "label",
        ),
        (('name = "mine"', 'name = "../mine"'), "name", None),
        (('name = "mine"', 'name = "mine'), "TOML", "TOML"),
        (('name = "mine"', 'name = "mine"\nlimit = 0'), "limit", None),
        (("[[methods]]", "[[methods]]\n[[methods]]"), "gvr-paper", "label"),
        (("[[datasets]]", "[datasets]"), "datasets", None),
    ],
)
def test_a_mistake_names_file_place_and_what_is_accepted(
    tmp_path: Path, change: tuple[str, str], found: str, accepted: str | None
) -> None:
    path = write(tmp_path, GOOD.replace(*change))
    with pytest.raises(ConfigError) as caught:
        parse_suite(path)
    assert str(path) in str(caught.value)
    assert found in str(caught.value)
    if accepted:
        assert accepted in (caught.value.accepted or "")


def test_unknown_suite_lists_those_there_are() -> None:
    with pytest.raises(ConfigError, match="bench") as caught:
        read_suite("nightly")
    assert "composite" in str(caught.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        read_suite(str(tmp_path / "none.toml"))


def test_overrides_keep_the_suites_own_settings(tmp_path: Path) -> None:
    suite = parse_suite(write(tmp_path, GOOD))
    chosen = override(suite, methods=["random-patch", "gvr-paper"], limit=3)
    assert [m.method for m in chosen.methods] == ["random-patch", "gvr-paper"]
    assert chosen.methods[1].locate.top_k == 5
    assert chosen.limit == 3
    assert override(suite) == suite


@pytest.mark.parametrize(
    "wrong",
    [{"methods": ["gvr"]}, {"datasets": ["lerf"]}, {"limit": 0}, {"models": ["clip"]}],
    ids=str,
)
def test_overrides_are_checked(tmp_path: Path, wrong: dict) -> None:
    suite = parse_suite(write(tmp_path, GOOD))
    with pytest.raises(ConfigError):
        override(suite, **wrong)


SETS = """
name = "sets"
[[datasets]]
name = "gallery"
[[methods]]
method = "gvr-paper"
leave_one_out = true
[[methods]]
method = "lift"
[[models]]
label = "truth"
segmenter = "oracle"
encoder = "oracle"
text_segmenter = "oracle"
[[models]]
label = "chance"
encoder = "random:7"
"""
ABLATIONS = ["w/o RFL", "w/o SMFI", "w/o RFL and SMFI"]


def test_every_method_and_variant_runs_with_every_model_set(tmp_path: Path) -> None:
    lines = parse_suite(write(tmp_path, SETS)).lines()
    labels = ["gvr-paper", *ABLATIONS, "lift"]
    assert [line.name for line in lines] == [
        f"{label} · {models}" for models in ("truth", "chance") for label in labels
    ]
    assert [line.label for line in lines] == labels * 2
    assert [line.model_set for line in lines] == ["truth"] * 5 + ["chance"] * 5
    assert [line.reference for line in lines[:5]] == [None, *["gvr-paper · truth"] * 4]
    assert lines[9].reference == "gvr-paper · chance"
    assert [line.is_variant for line in lines[:5]] == [False, True, True, True, False]
    assert {line.models.encoder for line in lines[:5]} == {"oracle"}
    assert {line.models.encoder for line in lines[5:]} == {"random:7"}
    assert not any(line.method.leave_one_out for line in lines)
    assert [line.method.locate.rfl for line in lines[:5]] == [True, False, True, False, True]


def test_a_variant_is_compared_with_its_own_method(tmp_path: Path) -> None:
    text = GOOD + '[[methods]]\nmethod = "gvr-paper"\nlabel = "mine"\nleave_one_out = true\n'
    lines = parse_suite(write(tmp_path, text)).lines()
    assert [(line.name, line.reference) for line in lines] == [
        ("gvr-paper", None),
        ("mine", "gvr-paper"),
        *((f"mine {name}", "mine") for name in ABLATIONS),
    ]


def test_a_single_set_of_models_needs_no_label(tmp_path: Path) -> None:
    (line,) = parse_suite(write(tmp_path, GOOD)).lines()
    assert (line.name, line.label, line.model_set) == ("gvr-paper", "gvr-paper", "")


def test_names_that_make_one_folder_are_refused(tmp_path: Path) -> None:
    twin = GOOD + '[[methods]]\nmethod = "gvr-paper"\nlabel = "gvr/paper"\n'
    twin += '[[methods]]\nmethod = "gvr-paper"\nlabel = "gvr paper"\n'
    with pytest.raises(ConfigError, match="gvr/paper and gvr paper"):
        parse_suite(write(tmp_path, twin))


@pytest.mark.parametrize(
    ("methods", "expected"),
    [
        (["gvr-paper"], ["gvr-paper", *ABLATIONS]),
        (["w/o SMFI"], ["w/o SMFI"]),
        (["w/o SMFI", "lift"], ["w/o SMFI", "lift"]),
        (["w/o SMFI", "gvr-paper"], ["gvr-paper", *ABLATIONS]),
        (["random-patch", "random-patch"], ["random-patch"]),
    ],
    ids=str,
)
def test_methods_are_picked_with_their_variants_or_one_by_one(
    tmp_path: Path, methods: list[str], expected: list[str]
) -> None:
    chosen = override(parse_suite(write(tmp_path, SETS)), methods=methods, models=["truth"])
    assert [line.label for line in chosen.lines()] == expected
    assert {line.model_set for line in chosen.lines()} == {"truth"}
    assert SuiteConfig.model_validate(chosen.model_dump(mode="json")) == chosen


def test_model_sets_are_picked_by_label_or_by_what_they_are(tmp_path: Path) -> None:
    suite = parse_suite(write(tmp_path, SETS))
    assert [m.label for m in override(suite, models=["chance"]).models] == ["chance"]
    (oracle,) = override(suite, models=["oracle", "oracle"]).models
    assert (oracle.segmenter, oracle.encoder, oracle.text_segmenter) == ("oracle",) * 3
    with pytest.raises(ConfigError) as caught:
        override(suite, models=["clip"])
    assert "chance, mobile-sam, onboard, oracle, paper, truth" in str(caught.value)


def test_what_is_named_twice_is_refused_or_run_once(tmp_path: Path) -> None:
    gallery = DatasetChoice(name="gallery")
    with pytest.raises(ConfigError, match="among the data sets, gallery twice"):
        SuiteConfig(name="s", datasets=(gallery, gallery))
    with pytest.raises(ConfigError, match="gallery_0 twice"):
        SuiteConfig(
            name="s", datasets=(DatasetChoice(name="gallery", scenes=("gallery_0", "gallery_0")),)
        )
    plain = SuiteConfig(name="s", datasets=(gallery,))
    chosen = override(plain, datasets=["gallery", "gallery"], scenes=["gallery_0", "gallery_0"])
    assert chosen.datasets == (DatasetChoice(name="gallery", scenes=("gallery_0",)),)
