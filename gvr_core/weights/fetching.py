"""Fetching checkpoints into the models folder: all of a file that is right, or nothing.

A file takes its name only after its size and its digest were found right and it was read without
running code. This is the only part of the project that uses the network.
"""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from gvr_core.atomic import atomic_write, file_digest, sync_folder
from gvr_core.errors import ModelError, StoreError
from gvr_core.locks import file_lock, remove_if_free
from gvr_core.weights.folder import State, digest_path, look, models_folder, part_path
from gvr_core.weights.manifest import Entry, WeightsFile, find_entry
from gvr_core.weights.offers import NotThereError, Wanted
from gvr_core.weights.safety import check_harmless
from gvr_core.weights.transfer import PATIENCE, Patience, forget, transfer

log = logging.getLogger(__name__)

Progress = Callable[[WeightsFile, int, int | None], None]
"""Told the file, the bytes of it that are there, and how many there will be, if known."""


class Trust(StrEnum):
    """Who said what the digest of a file should be."""

    MANIFEST = "manifest"
    RECORD = "record of the first fetch"
    SERVER = "server"
    FIRST_USE = "nobody; recorded now"


@dataclass(frozen=True)
class Fetched:
    """A file that is in place."""

    file: WeightsFile
    path: Path
    sha256: str
    trust: Trust
    new: bool
    """False where it was there already."""


def fetch(
    name: str,
    folder: Path | None = None,
    progress: Progress | None = None,
    patience: Patience = PATIENCE,
) -> tuple[Fetched, ...]:
    """Fetch a checkpoint, and what it needs, unless they are there.

    Args:
        name: As suites say it, e.g. ``sam:vit_h``.
        folder: The models folder, where it is not the usual one.
        progress: Told about each piece of each file.
        patience: How often a broken connection is taken up again without any progress.

    Returns:
        One for each file, of what it needs after its own.

    Raises:
        ModelError: for an unknown name, or the first file that cannot be fetched.
    """
    folder = folder or models_folder()
    return tuple(
        fetch_file(file, folder, progress, patience)
        for entry in with_needs(find_entry(name, folder), folder)
        for file in entry.files
    )


def with_needs(entry: Entry, folder: Path) -> list[Entry]:
    """An entry and all that it needs, each once."""
    entries = {entry.name: entry}
    queue = list(entry.needs)
    while queue:
        name = queue.pop(0)
        if name not in entries:
            entries[name] = find_entry(name, folder)
            queue.extend(entries[name].needs)
    return list(entries.values())


def fetch_file(
    file: WeightsFile,
    folder: Path,
    progress: Progress | None = None,
    patience: Patience = PATIENCE,
) -> Fetched:
    """Fetch one file, unless it is there and right.

    A broken fetch is gone on with, by this call and by the next. Two calls for one file: the
    second waits, and finds it there. A file with another content than the digest says is
    replaced, once the right one is whole.

    Args:
        file: The file; where the server has none, what stands in for it is fetched.
        folder: The models folder.
        progress: Told about each piece.
        patience: How often a broken connection is taken up again without any progress.

    Raises:
        ModelError: if it cannot be fetched, does not fit on the disk, has another size or digest
            than it should, or wants to run code. Nothing has taken its name then.
    """
    # One that is there first: no server need be asked about the others.
    candidates = sorted(
        file.candidates(), key=lambda each: look(each, folder).state is not State.PRESENT
    )
    for candidate in candidates[:-1]:
        try:
            return _fetch_one(candidate, folder, progress, patience)
        except NotThereError:
            log.info("%s is not there; trying what stands in for it", candidate.url)
    return _fetch_one(candidates[-1], folder, progress, patience)


def _fetch_one(
    file: WeightsFile, folder: Path, progress: Progress | None, patience: Patience
) -> Fetched:
    path = folder / file.path
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with _alone(path):
            return _present(file, folder) or _bring(file, folder, progress, patience)
    except OSError as error:
        raise ModelError(f"cannot be written: {error.strerror}", path=path) from error


def _present(file: WeightsFile, folder: Path) -> Fetched | None:
    there = look(file, folder)
    if there.state is not State.PRESENT:
        return None
    found = file_digest(there.path)
    if there.sha256 is None:
        check_harmless(there.path, str(there.path))
        _record(there.path, found)
        return Fetched(file, there.path, found, Trust.FIRST_USE, new=False)
    if found != there.sha256:
        return None
    trust = Trust.RECORD if there.recorded else Trust.MANIFEST
    return Fetched(file, there.path, found, trust, new=False)


def _bring(
    file: WeightsFile, folder: Path, progress: Progress | None, patience: Patience
) -> Fetched:
    there = look(file, folder)
    path, part = there.path, part_path(there.path)

    def check_room(size: int) -> None:
        free = shutil.disk_usage(path.parent).free
        if size > free:
            raise ModelError(
                f"{size:,} more bytes do not fit: {free:,} are free", path=path, accepted="room"
            )

    def report(done: int, total: int | None) -> None:
        if progress is not None:
            progress(file, done, total)

    reason = f", as {digest_path(path)} says; delete that to take another" if there.recorded else ""
    wanted = Wanted(file.url, path, file.size, there.sha256, reason)
    offer = transfer(wanted, part, check_room, report, patience)
    try:
        found = _checked(part, path, wanted, there.sha256 or offer.sha256)
    except ModelError:
        forget(part)
        raise
    if file.sha256 is None and not there.recorded:
        _record(path, found)
    with part.open("rb") as stream:
        os.fsync(stream.fileno())
    part.replace(path)
    sync_folder(path.parent)
    forget(part)
    return Fetched(file, path, found, _trust(file, there.recorded, offer.sha256), new=True)


def _checked(part: Path, path: Path, wanted: Wanted, sha256: str | None) -> str:
    size = part.stat().st_size
    if wanted.size is not None and size != wanted.size:
        raise ModelError(
            f"what {wanted.url} gave has {size:,} bytes; refused and deleted",
            path=path,
            accepted=f"{wanted.size:,} bytes",
        )
    found = file_digest(part)
    if sha256 is not None and found != sha256:
        raise ModelError(
            f"what {wanted.url} gave has sha256 {found}; refused and deleted",
            path=path,
            accepted=f"sha256 {sha256}{wanted.reason}",
        )
    check_harmless(part, str(path))
    return found


def _trust(file: WeightsFile, recorded: bool, stated: str | None) -> Trust:
    if file.sha256 is not None:
        return Trust.MANIFEST
    if recorded:
        return Trust.RECORD
    return Trust.FIRST_USE if stated is None else Trust.SERVER


def _record(path: Path, digest: str) -> None:
    """Write a digest down in the form that ``sha256sum --check`` reads."""
    with atomic_write(digest_path(path)) as stream:
        stream.write(f"{digest}  {path.name}\n".encode())


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Let no other fetch of a file run; wait for one that does."""
    lock = path.with_name(f".{path.name}.lock")
    try:
        with file_lock(lock, timeout=0):
            pass
    except StoreError:
        log.warning("another fetch of %s is running; waiting for it", path.name)
    try:
        with file_lock(lock):
            yield
    finally:
        remove_if_free(lock)
