"""Writing files so that nobody ever sees half of one, and telling changed files from unchanged."""

from __future__ import annotations

import os
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from safetensors import SafetensorError

from gvr_core.atomic import why_not_written
from gvr_core.errors import StoreError

_RACY_SECONDS = 2.0
"""A file changed this recently may change again without its time stamps moving: kernels stamp
files with a clock of a few milliseconds, some file systems of two seconds."""


def sync_file(path: Path) -> None:
    """Wait until a file's content, or a folder's list of names, is on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def temporary_name(folder: Path, suffix: str = "") -> Path:
    """A name in the folder (made where missing) that no other process or thread will choose."""
    folder.mkdir(parents=True, exist_ok=True)
    return folder / f"{os.getpid()}-{uuid.uuid4().hex}{suffix}"


@contextmanager
def storing(root: Path) -> Iterator[None]:
    """Make what the disk refuses an error of the store.

    Raises:
        StoreError: Something in the block could not be written; it names the store, and the room
            that is left where that is why.
    """
    try:
        yield
    except (OSError, SafetensorError) as error:
        reason = why_not_written(error, root)
        raise StoreError(f"the store {root} cannot be written: {reason}") from error


def write_atomically(path: Path, data: bytes, temporary_folder: Path) -> None:
    """Write a whole file or none: temporary name, fsync, rename, fsync of the folder.

    Args:
        path: The file to make or replace; its folder is made where missing.
        data: Its content.
        temporary_folder: Where the temporary file lies; on the same file system.
    """
    temporary = temporary_name(temporary_folder)
    try:
        temporary.write_bytes(data)
        sync_file(temporary)
        move_into_place(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def move_into_place(temporary: Path, path: Path) -> None:
    """Rename a finished and synced file to its name, and make the name last."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary.replace(path)
    sync_file(path.parent)


@dataclass(frozen=True)
class Stamp:
    """What the file system says about a file; any write to it changes this.

    Unlike the modification time, ``changed`` (ctime) cannot be set back by a program.
    """

    device: int
    inode: int
    size: int
    modified: int
    changed: int

    @classmethod
    def of(cls, path: Path) -> Stamp:
        """The stamp of a file, not following symbolic links."""
        found = path.lstat()
        return cls(found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns)

    @property
    def settled(self) -> bool:
        """Whether the last change is old enough for a later one to show in the stamp."""
        return time.time_ns() - self.changed > _RACY_SECONDS * 1e9
