"""Cache keys: they change with every part and with nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gvr_core.errors import StoreError
from tasks.store import Store, stage_key

DIGEST = "0" * 64


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


def test_key_changes_with_every_part_and_with_nothing_else() -> None:
    inputs, config = {"scene": "ab" * 32, "views": "cd" * 32}, {"a": 1, "b": [True, None, 0.5]}
    key = stage_key("render", 1, inputs, config)
    assert key == stage_key("render", 1, dict(reversed(inputs.items())), {"b": config["b"], "a": 1})
    others = {
        stage_key("masks", 1, inputs, config),
        stage_key("render", 2, inputs, config),
        stage_key("render", 1, inputs | {"scene": "ef" * 32}, config),
        stage_key("render", 1, {"views": inputs["scene"], "scene": inputs["views"]}, config),
        stage_key("render", 1, inputs, config | {"a": 2}),
        stage_key("render", 1, inputs, config | {"c": None}),
    }
    assert len(others | {key}) == 7


@pytest.mark.parametrize(
    ("value", "place"),
    [
        ({"a": {"b": [1, (2,)]}}, r"a\.b\[1\] is of type tuple"),
        ({"a": Path("x")}, "a is of type PosixPath"),
        ({"a": np.float64(1)}, "a is of type float64"),
        ({"a": float("nan")}, "a is nan"),
        ({"a": {1: 2}}, "a has the key 1"),
        ({"a": {1, 2}}, "a is of type set"),
    ],
)
def test_values_that_are_not_json_cannot_be_keys(value: dict, place: str) -> None:
    with pytest.raises(StoreError, match=place):
        stage_key("render", 1, {}, value)


def test_bad_names_and_inputs_are_refused(store: Store) -> None:
    with pytest.raises(StoreError, match="input 'scene' is 'gallery'"):
        stage_key("render", 1, {"scene": "gallery"}, {})
    for name in ("../x", "Render", "", "a/b", "a" * 49):
        with pytest.raises(StoreError, match="stage name"):
            store.lookup(name, DIGEST)
    for key in ("../x", "", "0" * 63, "G" * 64):
        with pytest.raises(StoreError, match="stage key"):
            store.lookup("render", key)
