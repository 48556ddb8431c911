"""Spoilt records, arrays and results: refused with an error of ours, or read."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hostile_inputs import damaged, misled, quickly, read, seeds
from hypothesis import given
from hypothesis import strategies as st
from record_samples import make_sample, reseal

from reports.result_check import ResultError
from reports.result_io import read_result, write_result

JSON = ["stage-record", "store-lookup", "prefect-result", "result-result.json", "result-rows.jsonl"]


@pytest.mark.parametrize("name", [*JSON, "stored-arrays", "result-SHA256SUMS"])
@quickly
@given(data=st.data())
def test_damaged_files(name: str, data: st.DataObject) -> None:
    read(name, data.draw(damaged(name)))


@pytest.mark.parametrize("name", JSON)
@quickly
@given(data=st.data())
def test_values_of_other_kinds(name: str, data: st.DataObject) -> None:
    read(name, data.draw(misled(name)))


@pytest.fixture
def result(tmp_path: Path) -> Path:
    return write_result(tmp_path / "result", *make_sample())


def set_picture(folder: Path, name: str) -> None:
    content = json.loads((folder / "result.json").read_text())
    content["scenes"][0]["queries"][0]["picture"] = name
    (folder / "result.json").write_text(json.dumps(content))
    reseal(folder)


@pytest.mark.parametrize(
    "name",
    [
        "../secret.png", "/etc/passwd", "pictures/../../secret.png", "pictures/./a.png", "a.png",
        "pictures/a\0.png", "pictures/\u202ea.png", "pictures", "pictures//a.png", "result.json",
    ],
)  # fmt: skip
def test_a_picture_that_lies_elsewhere_is_not_copied(result: Path, name: str) -> None:
    set_picture(result, name)
    with pytest.raises(ResultError, match=r"a picture named .*accepted: pictures/<name>"):
        read_result(result)


@pytest.mark.parametrize("linked", ["file", "folder"])
def test_a_picture_that_is_a_link_is_not_copied(result: Path, tmp_path: Path, linked: str) -> None:
    pictures = result / "pictures"
    picture = next(pictures.iterdir())
    elsewhere = tmp_path / "elsewhere"
    if linked == "file":
        picture.rename(elsewhere)
        picture.symlink_to(elsewhere)
    else:
        pictures.rename(elsewhere)
        pictures.symlink_to(elsewhere)
    with pytest.raises(ResultError, match="symbolic link"):
        read_result(result)


def test_what_is_spoilt_was_good(result: Path) -> None:
    read_result(result)
    for name in [*JSON, "stored-arrays"]:
        assert all(read(name, seed) for seed in seeds(name))
