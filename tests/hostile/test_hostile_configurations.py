"""Spoilt suites, manifests, layouts and model configurations: errors of ours, or read."""

from __future__ import annotations

import pytest
from hostile_inputs import damaged, misled, quickly, read, seeds
from hypothesis import given
from hypothesis import strategies as st

TOML = ["suite", "manifest", "layout", "grounding-dino-config"]
JSON = ["open-clip-config", "bert-config"]


@pytest.mark.parametrize("name", TOML + JSON)
@quickly
@given(data=st.data())
def test_damaged_files(name: str, data: st.DataObject) -> None:
    read(name, data.draw(damaged(name)))


@pytest.mark.parametrize("name", JSON)
@quickly
@given(data=st.data())
def test_values_of_other_kinds(name: str, data: st.DataObject) -> None:
    read(name, data.draw(misled(name)))


TOML_TEXTS = {
    "lists without end": "a = " + "[" * 5000,
    "tables without end": "a = " + "{a = " * 5000,
    "a key of thousands of parts": "a." * 16_000 + "a = 1",
    "the same between quotes": '"=".' * 8_000 + "a = 1",
    "the same as a table": "[" + "a." * 16_000 + "a]",
    "a number of thousands of digits": "limit = " + "9" * 5000,
    "the same in hexadecimal": "limit = 0x" + "f" * 5000,
    "the same where anything goes": (
        'name = "a"\n[[datasets]]\nname = "gallery"\nsettings = { seeds = 0x' + "f" * 5000 + " }"
    ),
    "a zero character": 'name = "a\\u0000b"',
    "a date": "name = 1979-05-27",
    "no date": "name = 1979-02-31",
    "a lone surrogate": 'name = "\\ud800"',
    "more than 64 KB": "#" + "a" * 70_000,
    "an unknown home": (
        'name = "a"\n[[datasets]]\nname = "lerf_ovs"\nsettings = { root = 5 }\n'
        '[[methods]]\nmethod = "predictions"\npredictions = { folder = "~nobody-here" }\nx = 1'
    ),
}


@pytest.mark.parametrize("name", TOML)
@pytest.mark.parametrize("text", TOML_TEXTS.values(), ids=TOML_TEXTS)
def test_toml_that_breaks_its_parser(name: str, text: str) -> None:
    assert not read(name, text.encode())


@quickly
@given(st.text(max_size=60))
def test_any_text_as_a_name(text: str) -> None:
    quoted = "".join(f"\\U{ord(c):08X}" for c in text)
    dataset = f'[[datasets]]\nname="folder:{quoted}"\nscenes=["{quoted}"]\n'
    read("suite", f'name="a"\nexperiment="x{quoted}"\n{dataset}'.encode())
    read("suite", f'name="a"\n[[datasets]]\nname="gallery"\n[[methods]]\nlabel="{quoted}"'.encode())


def test_what_is_spoilt_was_good() -> None:
    for name in TOML + JSON:
        assert all(read(name, seed) for seed in seeds(name))
