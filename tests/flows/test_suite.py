"""Suites: what is accepted, and how a mistake is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from flows.suite import bundled_suites, override, parse_suite, read_suite
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
    assert suite.models.encoder == "onboard-conse"


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
    "wrong", [{"methods": ["gvr"]}, {"datasets": ["lerf"]}, {"limit": 0}], ids=str
)
def test_overrides_are_checked(tmp_path: Path, wrong: dict) -> None:
    suite = parse_suite(write(tmp_path, GOOD))
    with pytest.raises(ConfigError):
        override(suite, **wrong)
