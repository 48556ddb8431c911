"""A store of two tiers: a local folder that works, and a shared one behind a URL that remembers.

Everything is computed into and read from the local folder, with its locks and renames. The
shared one (`tasks.remote_tier`) is asked where the local one has no sound result, and gets what
was computed. What comes from it is checked, written under a temporary name and moved into place,
as if it had been computed here.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gvr_core.errors import StoreError
from gvr_core.locks import file_lock
from tasks.files import temporary_name
from tasks.findings import Notes
from tasks.lease import lease
from tasks.record_store import Ending, RecordStore
from tasks.records import Artifact, StageRecord, check_key, check_stage_name
from tasks.remote_tier import RemoteTier, distinct


class SharedStore(RecordStore):
    """Objects and records in a folder, and in a shared one where the store has a URL.

    Args:
        root: As for `tasks.objects.ObjectStore`.

    Raises:
        ConfigError: A URL that cannot be opened, e.g. for want of a package.
    """

    def __init__(self, root: Path | str | None = None) -> None:
        super().__init__(root)
        self.remote = RemoteTier(self.url, self.root) if self.url else None

    def check(self) -> None:
        """Make sure that the shared store can be used; nothing where there is none.

        Raises:
            StoreError: It refuses; see `tasks.remote_tier.RemoteTier.check`.
        """
        if self.remote is not None:
            self.remote.check()

    def push(self, record: StageRecord, notes: Notes | None = None, *, new: bool = False) -> bool:
        """Put a record of the local folder, and its objects, into the shared store.

        Args:
            record: The record.
            notes: Get the reason where it does not work.
            new: It was computed now, and is not there.

        Returns:
            Whether it is there now; False also where there is no shared store.
        """
        notes = notes if notes is not None else Notes()
        return self.remote is not None and self.remote.push(record, self.locate, notes, new=new)

    def _find(self, stage: str, key: str, notes: Notes) -> tuple[StageRecord | None, Ending]:
        record, ending = self._find_here(stage, key, notes)
        if self.remote is None:
            return record, ending
        if record is None:
            return self._fetch(self.remote, stage, key, notes), ending
        if not self.remote.knows(record):
            self.push(record, notes)  # from before there was a URL, or from a time of failure
        return record, ending

    def _share(self, record: StageRecord, notes: Notes) -> None:
        self.push(record, notes, new=True)

    @contextmanager
    def _turn(
        self, stage: str, key: str, refresh: bool, notes: Notes
    ) -> Iterator[StageRecord | None]:
        remote = self.remote
        if remote is None or refresh or remote.resting or remote.read_only:
            yield None
            return
        name = f"leases/{check_stage_name(stage)}/{check_key(key)}"
        with lease(remote.folder, name, lambda: self._fetch(remote, stage, key, notes)) as record:
            yield record

    def _fetch(self, remote: RemoteTier, stage: str, key: str, notes: Notes) -> StageRecord | None:
        """Copy a result from the shared store into the local folder.

        Returns:
            The record; None where there is none over there, or not all of it is sound.
        """
        # A few locks for all keys: a file for each would outlive what it guards.
        with file_lock(self.root / "locks" / f"fetch-{check_key(key)[:2]}.lock") as lock:
            os.utime(lock)
            record = self._find_here(stage, key, Notes())[0]
            if record is not None:
                return record  # another process fetched or computed it meanwhile
            record = remote.record(stage, key, notes)
            if record is None:
                return None
            try:
                for artifact in record.artifacts.values():
                    self.locate(artifact)
            except StoreError as error:
                notes.add("record", "shared", remote.name_of(record), str(error))
                remote.damaged(remote.name_of(record))
                return None
            arrived = remote.each(
                lambda artifact: self._bring(remote, artifact, notes), distinct(record)
            )
            if not all(arrived):
                return None
            self._write_record(record)
            remote.note_known(record)
            notes.fetched = True
            return record

    def _bring(self, remote: RemoteTier, artifact: Artifact, notes: Notes) -> bool:
        """Have an artifact's object in the local folder; False where that is not possible."""
        if self.problem(artifact) is None:
            with file_lock(self.guard, shared=True):
                try:
                    os.utime(self.locate(artifact))  # spared by a collector until it is recorded
                    return True
                except OSError:
                    pass  # collected a moment ago, or another user's
        temporary = temporary_name(self.temporary, ".fetched")
        try:
            if not remote.fetch(artifact, temporary, notes):
                return False
            self._keep(temporary, artifact)
            return True
        finally:
            temporary.unlink(missing_ok=True)
