from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from gvr_core.errors import StoreError
from gvr_core.locks import file_lock, remove_if_free


def acquire(path: Path, timeout: float) -> None:
    with file_lock(path, timeout=timeout):
        pass


def test_exclusive_lock_excludes_and_shared_locks_do_not(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "lock"
    with file_lock(path), pytest.raises(StoreError, match="locked by another run"):
        acquire(path, timeout=0)
    two_readers = file_lock(path, shared=True), file_lock(path, shared=True, timeout=0)
    refused = pytest.raises(StoreError, match=r"waited 0\.05 s")
    with two_readers[0], two_readers[1], refused:
        acquire(path, timeout=0.05)
    with file_lock(path, timeout=0):
        assert not remove_if_free(path) and path.exists()
    assert remove_if_free(path) and not path.exists()


def test_locks_exclude_while_their_file_is_deleted_again_and_again(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    inside, most, total = 0, 0, 0
    stop = time.monotonic() + 1.0
    guard = threading.Lock()

    def work() -> None:
        nonlocal inside, most, total
        while time.monotonic() < stop:
            with file_lock(path):
                with guard:
                    inside += 1
                    most = max(most, inside)
                time.sleep(0.001)
                with guard:
                    inside -= 1
                    total += 1

    def delete() -> None:
        while time.monotonic() < stop:
            remove_if_free(path)

    threads = [threading.Thread(target=work) for _ in range(4)]
    threads.append(threading.Thread(target=delete))
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == 1 and total > 20
