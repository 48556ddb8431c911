"""What the store says of a full disk, and what it notices in a record."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gvr_core.errors import StoreError
from tasks.store import Store

KEY = "ab" * 32


def full(*_: Any, **__: Any) -> Any:
    """Test double: a disk that is full."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("where", ["tasks.files.sync_file", "tasks.objects.sync_file"])
def test_the_store_names_itself_and_the_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    store = Store(tmp_path / "store")
    monkeypatch.setattr(where, full)
    with pytest.raises(StoreError, match=r"store cannot be written: no space left.*bytes free"):
        store.compute_once("demo", 1, KEY, lambda: {"a": store.put_arrays("a", {"x": np.ones(3)})})
    monkeypatch.undo()
    assert store.lookup("demo", KEY) is None
    assert list(store.temporary.iterdir()) == [] and store.verify().sound


def test_a_stage_keeps_its_own_errors(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    with pytest.raises(OSError, match="No space left"):
        store.compute_once("demo", 1, KEY, full)


def test_a_flipped_digit_in_a_record_is_found(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    store.compute_once("demo", 1, KEY, lambda: {"a": store.put_json("a", 1)})
    path = store.record_path("demo", KEY)
    sound = path.read_text()
    path.write_text(sound.replace('"created":"2', '"created":"3'))
    assert store.lookup("demo", KEY) is None and store.counts.unreadable == 1
    assert not store.verify().sound
    before_there_were_sums = json.loads(sound)
    del before_there_were_sums["checksum"]
    path.write_text(json.dumps(before_there_were_sums))
    assert store.lookup("demo", KEY) is not None
