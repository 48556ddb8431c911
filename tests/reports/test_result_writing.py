"""Results on full disks, after killed writers, and damaged ones."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import pytest
from record_samples import make_sample

from gvr_core.errors import InputError
from reports.result_check import ResultError, ResultWriteError
from reports.result_io import check_files, list_results, write_result


def full(*_: Any, **__: Any) -> Any:
    """Test double: a disk that is full."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


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
