"""Files that appear complete or not at all, and the digest of what is in them."""

from __future__ import annotations

import errno
import fcntl
import glob
import hashlib
import os
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

_YOUNG_SECONDS = 60.0
"""A writer locks its file right after making it; one that is older and free has lost its writer."""


@contextmanager
def atomic_write(path: Path) -> Iterator[BinaryIO]:
    """A binary stream whose content takes the path's name only once it is whole and on disk.

    The bytes go to a hidden neighbour of the path, which is flushed to the disk and renamed
    when the block ends, and deleted when the block raises. Those that killed writers of the same
    path have left are deleted first.

    Args:
        path: The file to make or to replace. Its folder is made where it is missing.

    Raises:
        OSError: if the folder or the file cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    _sweep(path)
    # A name of its own for each writer: two that write one path must not share a stream.
    temporary = path.parent / f".{path.name}.{uuid.uuid4().hex}.tmp"
    try:
        with temporary.open("xb") as stream:
            with suppress(OSError):  # a file system without locks: nothing is swept there
                fcntl.flock(stream, fcntl.LOCK_EX)  # until it is closed, however that happens
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise
    sync_folder(path.parent)


def _sweep(path: Path) -> None:
    """Delete what killed writers of a path have left beside it."""
    for left in path.parent.glob(f".{glob.escape(path.name)}.{'[0-9a-f]' * 32}.tmp"):
        with suppress(OSError), left.open("rb") as stream:
            if time.time() - left.stat().st_mtime > _YOUNG_SECONDS:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
                left.unlink()


def file_digest(path: Path) -> str:
    """sha256 of a file's content, in lower-case hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def why_not_written(error: Exception, folder: Path) -> str:
    """Why something could not be written, as a phrase; of a full disk, how full it is.

    Args:
        error: What writing raised; libraries that are no Python name a full disk in their text.
        folder: Where it was to be written; it need not exist.
    """
    full = (errno.ENOSPC, errno.EDQUOT)
    if getattr(error, "errno", None) not in full and os.strerror(errno.ENOSPC) not in str(error):
        return str(error)
    there = next((path for path in (folder, *folder.absolute().parents) if path.exists()), folder)
    disk = os.statvfs(there)
    files = f", room for {disk.f_favail:,} more files" if disk.f_files else ""
    return f"no space left in {folder} ({disk.f_bavail * disk.f_frsize:,} bytes free{files})"


def sync_folder(folder: Path) -> None:
    """Make a rename last through a power cut, where the file system can promise that."""
    # Windows and some network file systems have no such call: the rename itself still holds.
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
