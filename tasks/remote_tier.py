"""The shared tier of a store: the same objects and records, in a folder behind a URL.

::

    objects/ab/<sha256><suffix>   as in the local folder
    records/<stage>/<key>.json
    leases/<stage>/<key>          while a machine computes a key (tasks.lease)
    gvr-store.json                that this is a store, and its layout

Objects are put before the record that names them, so no record is ever seen without its objects.
What is read is treated like a local file that anybody may have written: parsed, checked, hashed,
never unpickled. A failure of the other side is never an error here: the answer is then "not
there", the failure is noted and logged once, and for half a minute nothing more is asked.

What the local folder knows of this URL lies in its ``shared/<id of the URL>/``: ``known/`` has an
empty file for each record that is over there too, ``heal/`` one for each object or record found
damaged there, which the next push replaces.
"""

from __future__ import annotations

import json
import logging
import re
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from gvr_core.atomic import file_digest
from gvr_core.errors import RemoteError, StoreError
from gvr_core.remote_folder import RemoteFolder
from gvr_core.remote_url import url_id
from tasks.findings import Notes
from tasks.objects import OBJECT
from tasks.records import (
    DIGEST,
    STAGE_NAME,
    Artifact,
    StageRecord,
    canonical_json,
    check_key,
    check_stage_name,
)

MARKER = "gvr-store.json"
LAYOUT = 1
RECORD_BYTES = 16 * 2**20
"""A longer record is not read."""

REST_SECONDS = 30.0
"""After a failure the other side is left alone for so long."""

FRESH_SECONDS = 12 * 3600.0
"""An object over there that is older is put again before a new record refers to it, as a
collector may be about to remove it; half of the collector's shortest grace period."""

SMALL_BYTES = 64 * 1024
"""Putting an object of this size costs no more than asking whether it is there."""

TRANSFERS = 4
"""Artifacts of one record that travel at the same time."""

_RECORD = re.compile(rf"records/{STAGE_NAME.pattern}/{DIGEST.pattern}\.json")

log = logging.getLogger(__name__)

_T = TypeVar("_T")
_R = TypeVar("_R")


@dataclass
class _Health:
    """How the other side of a URL does, for all stores of this process."""

    resting_until: float = 0.0
    reason: str = ""
    warned: bool = False
    read_only: bool = False


_health: dict[str, _Health] = {}
_health_guard = threading.Lock()


class RemoteTier:
    """The shared tier of one store.

    Args:
        url: The folder.
        local: The local store's folder, for what is known of the other side.

    Raises:
        ConfigError: A URL that cannot be opened.
    """

    def __init__(self, url: str, local: Path) -> None:
        self.folder = RemoteFolder(url)
        self.url = self.folder.url
        self._marks = local / "shared" / url_id(self.url)
        with _health_guard:
            self._health = _health.setdefault(self.url, _Health())

    def check(self) -> None:
        """Make sure that this is a store, making it one where it is empty.

        A server that cannot be reached is warned of and no more: a run goes on without it.

        Raises:
            StoreError: The other side refuses (no such bucket, no permission, bad credentials),
                or holds a store of a layout that is not known.
        """
        try:
            text = self.folder.read(MARKER, 1000)
            if text is None:
                self.folder.write(MARKER, canonical_json({"layout": LAYOUT}))
                return
        except RemoteError as error:
            if error.refused:
                raise StoreError(f"the shared store cannot be used: {error}") from error
            self._failed(error)
            return
        try:
            layout = json.loads(text)["layout"]
        except (ValueError, RecursionError, KeyError, TypeError):
            layout = None
        if layout != LAYOUT:
            raise StoreError(f"{self.url}/{MARKER}: {text[:60]!r} (accepted: layout {LAYOUT})")

    # Reading

    def record(self, stage: str, key: str, notes: Notes) -> StageRecord | None:
        """The record of a stage and key over there; None where there is none that can be used."""
        name = record_name(stage, key)
        text = self.attempt(lambda: self.folder.read(name, RECORD_BYTES + 1), notes, None)
        if text is None:
            return None
        finding = "is not a stage record of this schema, or was changed"
        if len(text) > RECORD_BYTES:
            finding = f"has more than {RECORD_BYTES} bytes"
        else:
            try:
                record = StageRecord.from_json(text)
                if (record.stage, record.key) == (stage, key):
                    return record
                finding = "is the record of another stage or key"
            except StoreError:
                pass
        notes.add("record", "shared", name, finding)
        self.damaged(name)
        return None

    def fetch(self, artifact: Artifact, target: Path, notes: Notes) -> bool:
        """Copy an artifact's object to a path here, and check its content.

        Returns:
            Whether what lies at the path now is the artifact.
        """

        def copy() -> str | None:
            finding = self.folder.download(artifact.path, target, artifact.bytes)
            if finding is None and file_digest(target) != artifact.digest:
                finding = "has another content than its digest says"
            return finding

        failed = "could not be fetched"
        finding = self.attempt(copy, notes, failed)
        if finding not in (None, failed):
            notes.add("artifact", "shared", artifact.path, str(finding))
            self.damaged(artifact.path)
        return finding is None

    # Writing

    def push(
        self,
        record: StageRecord,
        locate: Callable[[Artifact], Path],
        notes: Notes,
        *,
        new: bool = False,
    ) -> bool:
        """Put a record's objects, where they are not there yet, and then the record.

        Args:
            record: A sound record of the local store.
            locate: Where the file of an artifact is.
            notes: Get the reason where it does not work.
            new: It was computed now: the record is put without asking whether it is there.

        Returns:
            Whether everything is there now.
        """
        name = record_name(record.stage, record.key)
        text = canonical_json(record.to_json(), name=name)

        def put() -> bool:
            there = (
                not new and self.folder.read(name, RECORD_BYTES) == text and not self._heals(name)
            )

            def put_object(artifact: Artifact) -> None:
                if self._needs(artifact, there):
                    self.folder.upload(locate(artifact), artifact.path)
                    self._healed(artifact.path)

            self.each(put_object, distinct(record))
            if not there:
                self.folder.write(name, text)
                self._healed(name)
            self._known(record.stage, record.key).parent.mkdir(parents=True, exist_ok=True)
            self._known(record.stage, record.key).touch()
            return True

        if self.read_only:
            notes.unshared = notes.unshared or f"{self.url} may only be read"
            return False
        return self.attempt(put, notes, False, writing=True)

    def _needs(self, artifact: Artifact, named: bool) -> bool:
        """Whether an object has to be put, its record being there already or not."""
        if self._heals(artifact.path) or (artifact.bytes <= SMALL_BYTES and not named):
            return True
        entry = self.folder.entry(artifact.path)
        if entry is None or entry.size != artifact.bytes:
            return True
        fresh = entry.modified is not None and time.time() - entry.modified < FRESH_SECONDS
        return not (named or fresh)

    def each(self, function: Callable[[_T], _R], items: Sequence[_T]) -> list[_R]:
        """Call a function for each item, a few at a time; the first error ends it."""
        if len(items) < 2 or not self.folder.concurrent:
            return [function(item) for item in items]
        with ThreadPoolExecutor(min(TRANSFERS, len(items))) as pool:
            return list(pool.map(function, items))

    # What is known of the other side

    def knows(self, record: StageRecord) -> bool:
        """Whether a record was put or fetched, and none of it found damaged since."""
        names = [record_name(record.stage, record.key)]
        names += [artifact.path for artifact in record.artifacts.values()]
        return self._known(record.stage, record.key).exists() and not any(map(self._heals, names))

    @staticmethod
    def is_record(name: str) -> bool:
        """Whether a file over there has the name of a record."""
        return _RECORD.fullmatch(name) is not None

    @staticmethod
    def is_object(name: str) -> bool:
        """Whether a file over there has the name of an object."""
        return OBJECT.fullmatch(name) is not None

    @staticmethod
    def name_of(record: StageRecord) -> str:
        """A record's name in the store."""
        return record_name(record.stage, record.key)

    def note_known(self, record: StageRecord) -> None:
        """A record came from there."""
        path = self._known(record.stage, record.key)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()

    def damaged(self, name: str) -> None:
        """A file over there was found damaged or missing: the next push puts it anew."""
        path = self._heal(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()

    def _heals(self, name: str) -> bool:
        return self._heal(name).exists()

    def _healed(self, name: str) -> None:
        self._heal(name).unlink(missing_ok=True)

    def _heal(self, name: str) -> Path:
        return self._marks / "heal" / name.replace("/", "-")

    def _known(self, stage: str, key: str) -> Path:
        return self._marks / "known" / check_stage_name(stage) / check_key(key)

    # Failures

    @property
    def read_only(self) -> bool:
        """Whether the other side refused to take something, in this process."""
        return self._health.read_only

    @property
    def resting(self) -> bool:
        """Whether the other side failed a moment ago, and is left alone."""
        return time.monotonic() < self._health.resting_until

    def attempt(
        self,
        action: Callable[[], _T],
        notes: Notes,
        otherwise: _T,
        *,
        writing: bool = False,
    ) -> _T:
        """Do something over there; where that fails, note it and return ``otherwise``."""
        if self.resting:
            notes.unshared = notes.unshared or self._health.reason
            return otherwise
        try:
            return action()
        except RemoteError as error:
            notes.unshared = notes.unshared or str(error)
            if writing and error.refused:
                self._refused_writing(error)
            else:
                self._failed(error)
            return otherwise

    def _failed(self, error: RemoteError) -> None:
        self._health.reason = str(error)
        self._health.resting_until = time.monotonic() + REST_SECONDS
        if not self._health.warned:
            self._health.warned = True
            log.warning("the shared store failed; going on with the local one: %s", error)

    def _refused_writing(self, error: RemoteError) -> None:
        self._health.read_only = True
        log.warning("the shared store takes nothing; going on without sharing: %s", error)


def distinct(record: StageRecord) -> list[Artifact]:
    """A record's artifacts, each object once."""
    return list({artifact.path: artifact for artifact in record.artifacts.values()}.values())


def record_name(stage: str, key: str) -> str:
    """The name of a record in a store, local or shared.

    Raises:
        StoreError: The stage's name or the key is not one.
    """
    return f"records/{check_stage_name(stage)}/{check_key(key)}.json"
