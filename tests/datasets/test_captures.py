"""Captures of one's own: splats, cameras and questions, without truth."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_captures import write_capture

from datasets.own import MAX_SIDE
from datasets.registry import get_dataset
from gvr_core.errors import ConfigError, DatasetError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_capture(tmp_path / "mine" / "egg")
    write_capture(tmp_path / "mine" / "ramen")
    (tmp_path / "mine" / "notes").mkdir()
    return tmp_path / "mine"


def test_scenes_that_are_asked_of_take_part(folder: Path) -> None:
    found = get_dataset(f"captures:{folder}", {"queries": {"ramen": ["a box", "a plane"]}})
    assert tuple(found.scenes()) == ("ramen",)
    data = found.load("ramen")
    assert [(query.id, query.text) for query in data.queries] == [
        ("q0", "a box"),
        ("q1", "a plane"),
    ]
    assert data.truth.labels is None and not data.truth.test_views
    assert len(data.scene.views) == 4
    assert all(max(v.camera.width, v.camera.height) <= MAX_SIDE for v in data.scene.views)


def test_other_questions_change_the_digest_of_the_queries_alone(folder: Path) -> None:
    first, second = (
        get_dataset(f"captures:{folder}", {"queries": {"egg": texts}}).load("egg").digests
        for texts in (["a box"], ["a plane"])
    )
    assert {part for part in first if first[part] != second[part]} == {"queries"}


def test_all_scenes_can_be_looked_at_without_questions(folder: Path) -> None:
    found = get_dataset(f"captures:{folder}", {})
    assert tuple(found.scenes()) == ("egg", "ramen")
    assert found.load("egg").queries == ()
    alone = get_dataset(f"captures:{folder / 'egg'}", {})
    assert tuple(alone.scenes()) == ("egg",)


@pytest.mark.parametrize(
    ("queries", "expected"),
    [
        (["a box"], r"captures\.settings\.queries: .*a table"),
        ({"egg": "a box"}, r"queries\.egg: 'a box' \(accepted: a list of different texts"),
        ({"egg": []}, "one or more"),
        ({"egg": ["a", "a"]}, "different texts"),
        ({"egg": [" "]}, "1 to 400 characters"),
        ({"eg": ["a box"]}, r"unknown scene of captures:.* 'eg'; did you mean 'egg'"),
    ],
)
def test_questions_that_cannot_be_asked(folder: Path, queries: object, expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        get_dataset(f"captures:{folder}", {"queries": queries})


def test_folders_without_captures(folder: Path) -> None:
    with pytest.raises(DatasetError, match="no capture here"):
        get_dataset(f"captures:{folder / 'notes'}", {})
    with pytest.raises(DatasetError, match="no such folder"):
        get_dataset(f"captures:{folder / 'none'}", {})
    with pytest.raises(ConfigError, match="unknown setting splats"):
        get_dataset(f"captures:{folder}", {"splats": "x"})
