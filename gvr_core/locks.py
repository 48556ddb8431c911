"""Locks between processes and between threads, that a killed holder cannot keep.

``flock`` belongs to an open file: every acquisition here opens its own, so two threads of one
process exclude each other as two processes do, and the kernel drops the lock when the holder
dies, however it dies.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gvr_core.errors import StoreError

_POLL_FIRST = 0.005
_POLL_LONGEST = 0.2

_open_files: set[int] = set()


def _close_after_fork() -> None:
    # A forked child shares the open file, and so would keep the lock of a killed parent.
    # Closing is enough: the lock itself stays with the parent.
    for descriptor in list(_open_files):
        os.close(descriptor)
    _open_files.clear()


os.register_at_fork(after_in_child=_close_after_fork)


@contextmanager
def file_lock(path: Path, *, shared: bool = False, timeout: float | None = None) -> Iterator[Path]:
    """Hold an advisory lock on a file for the length of a ``with`` block.

    Waiting polls (5 ms, growing to 0.2 s), so that Ctrl-C and ``timeout`` work in any thread.

    Args:
        path: The lock file; made where missing, and left behind. Or a folder that is there.
        shared: Many holders at once, as long as none holds it alone.
        timeout: Seconds to wait; None waits for ever, 0 tries once.

    Raises:
        StoreError: Somebody else still holds the lock after ``timeout``.
    """
    operation = (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB
    start = time.monotonic()
    pause = _POLL_FIRST
    while True:
        descriptor = _try_lock(path, operation)
        if descriptor is not None:
            break
        if timeout is not None and time.monotonic() - start >= timeout:
            raise StoreError(f"{path} is locked by another run (waited {timeout:g} s)")
        time.sleep(pause)
        pause = min(2 * pause, _POLL_LONGEST)
    try:
        yield path
    finally:
        # A child forked inside the block has already closed and forgotten its copy.
        if descriptor in _open_files:
            _open_files.discard(descriptor)
            os.close(descriptor)


def remove_if_free(path: Path) -> bool:
    """Delete a lock file that nobody holds.

    Returns:
        Whether it was deleted.
    """
    try:
        with file_lock(path, timeout=0):
            path.unlink()
            return True
    except (StoreError, FileNotFoundError):
        return False


def _try_lock(path: Path, operation: int) -> int | None:
    """The descriptor of the locked file, or None where another holds it."""
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        access = os.O_RDONLY if path.is_dir() else os.O_RDWR | os.O_CREAT
        try:
            descriptor = os.open(path, access | os.O_CLOEXEC, 0o644)
        except FileNotFoundError:
            continue  # the folder went away between the two lines
        _open_files.add(descriptor)
        try:
            fcntl.flock(descriptor, operation)
            if _is_same_file(descriptor, path):
                return descriptor
        except BlockingIOError:
            _close(descriptor)
            return None
        except BaseException:
            _close(descriptor)
            raise
        # Locked, but the file was deleted meanwhile: others would lock a new one.
        _close(descriptor)


def _is_same_file(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _close(descriptor: int) -> None:
    _open_files.discard(descriptor)
    os.close(descriptor)
