"""What writers say of a full disk, and what was damaged; the short form has real disks."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from record_samples import make_sample

from gvr_core.errors import InputError, StoreError
from reports.result_check import ResultError, ResultWriteError
from reports.result_io import check_files, list_results, write_result
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


def test_a_result_on_a_full_disk_is_no_mistake_of_the_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result, rows, pictures = make_sample()
    monkeypatch.setattr("reports.result_io.pq.write_table", full)
    with pytest.raises(ResultWriteError, match=r"no space left in .*results") as caught:
        write_result(tmp_path / "results" / "r", result, rows, pictures)
    assert not isinstance(caught.value, InputError)
    assert list((tmp_path / "results").iterdir()) == []


def test_what_killed_writers_of_results_left_is_swept(tmp_path: Path) -> None:
    result, rows, pictures = make_sample()
    left = tmp_path / ".r0.01234567.tmp"
    (left / "pictures").mkdir(parents=True)
    (left / "result.json").write_text("{")
    folder = write_result(tmp_path / "r1", result, rows, pictures)
    assert list(tmp_path.iterdir()) == [folder] == list_results(tmp_path)


def test_every_file_of_a_result_is_checked(tmp_path: Path) -> None:
    result, rows, pictures = make_sample()
    folder = write_result(tmp_path / "r", result, rows, pictures)
    check_files(folder)
    picture = folder / next(iter(pictures))
    data = picture.read_bytes()
    picture.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    with pytest.raises(ResultError, match=f"{picture.name}.*changed after it was written"):
        check_files(folder)
    picture.unlink()
    with pytest.raises(ResultError, match="missing"):
        check_files(folder)


def test_a_flipped_digit_in_a_record_is_found(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    store.compute_once("demo", 1, KEY, lambda: {"a": store.put_json("a", 1)})
    path = store.record_path("demo", KEY)
    sound = path.read_text()
    path.write_text(sound.replace('"created":"2', '"created":"3'))
    assert store.lookup("demo", KEY) is None and store.counts.unreadable == 1
    assert not store.verify().sound
    before_there_were_sums = json.loads(sound)
    del before_there_were_sums["sum"]
    path.write_text(json.dumps(before_there_were_sums))
    assert store.lookup("demo", KEY) is not None
