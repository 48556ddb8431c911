"""Records of what stages computed: the upper half of the artifact store."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from pydantic import JsonValue, ValidationError

from gvr_core.errors import StoreError
from gvr_core.locks import file_lock
from tasks.files import temporary_name, write_atomically
from tasks.findings import Notes
from tasks.measure import Measurement
from tasks.objects import ObjectStore
from tasks.records import Artifact, StageRecord, canonical_json, check_key, check_stage_name

_held = threading.local()


@dataclass(frozen=True)
class StageOutput:
    """What a stage's function returns where it has more to say than its artifacts."""

    artifacts: Mapping[str, Artifact]
    detail: Mapping[str, JsonValue] = field(default_factory=dict)
    """Counts and the like, for the record."""


StageFunction = Callable[[], StageOutput | Mapping[str, Artifact]]

Ending = Literal["sound", "none", "damaged", "unreadable"]
"""How the look-up of a record ended."""


@dataclass
class LookupCounts:
    """How the look-ups of one `Store` object ended."""

    hits: int = 0
    misses: int = 0
    """All that were not hits, the next two included."""
    damaged: int = 0
    """A record whose artifact was missing, truncated or of another content."""
    unreadable: int = 0
    """A record that was no JSON, of another schema, changed, or of another stage or key."""


class RecordStore(ObjectStore):
    """Objects and stage records in one folder, for any number of processes and threads.

    Args:
        root: As for `tasks.objects.ObjectStore`.
    """

    def __init__(self, root: Path | str | None = None) -> None:
        super().__init__(root)
        self.counts = LookupCounts()

    @property
    def location(self) -> str:
        """What names this store on this machine: its URL, or its folder."""
        return self.url or str(self.root)

    def __reduce__(self) -> tuple[type[RecordStore], tuple[Path | str]]:
        # Sent to another process, a store starts with nothing checked and nothing counted.
        return type(self), (self.url or self.root,)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.location!r})"

    def record_path(self, stage: str, key: str) -> Path:
        """Where the record of a stage and key lies.

        Raises:
            StoreError: The name or the key is not one.
        """
        return self.root / "records" / check_stage_name(stage) / f"{check_key(key)}.json"

    def lock_path(self, key: str) -> Path:
        """The file that is locked while a key is computed."""
        return self.root / "locks" / f"{check_key(key)}.lock"

    def lookup(self, stage: str, key: str, notes: Notes | None = None) -> StageRecord | None:
        """The record of a stage and key, if it and all its artifacts are sound.

        A hit renews the record's time stamp, which `tasks.upkeep.gc` goes by. A damaged object
        is moved to ``damaged/``, so that the stage is computed again; its record is left to be
        replaced by that.

        Args:
            stage: The stage's name.
            key: From `tasks.records.stage_key`.
            notes: Get what was found damaged.

        Returns:
            The record, or None. `counts` tells the kinds of None apart.

        Raises:
            StoreError: The name or the key is not one.
        """
        notes = notes if notes is not None else Notes()
        record, finding = self._find(stage, key, notes)
        self.counts.damaged += finding == "damaged"
        self.counts.unreadable += finding == "unreadable"
        if record is not None:
            self.counts.hits += 1
        else:
            self.counts.misses += 1
        return record

    def _find(self, stage: str, key: str, notes: Notes) -> tuple[StageRecord | None, Ending]:
        """The record, and how the look-up in the local folder ended."""
        return self._find_here(stage, key, notes)

    def _find_here(self, stage: str, key: str, notes: Notes) -> tuple[StageRecord | None, Ending]:
        path = self.record_path(stage, key)
        name = path.relative_to(self.root).as_posix()
        try:
            if not path.exists():
                return None, "none"
            with file_lock(self.guard, shared=True):
                with suppress(PermissionError):  # another user's, in a folder that several share
                    os.utime(path)
                text = path.read_bytes()
        except FileNotFoundError:
            return None, "none"
        except OSError as error:
            notes.add("record", "local", name, f"cannot be read: {error.strerror or error}")
            return None, "unreadable"
        try:
            record = StageRecord.from_json(text)
        except StoreError:
            reason = "is not a stage record of this schema, or was changed"
            notes.add("record", "local", name, reason)
            return None, "unreadable"
        if (record.stage, record.key) != (stage, key):
            notes.add("record", "local", name, "is the record of another stage or key")
            return None, "unreadable"
        sound = True
        for artifact in record.artifacts.values():
            finding = self.problem(artifact)
            if finding is not None:
                sound = False
                notes.add("artifact", "local", artifact.path, finding)
                self._move_away(artifact)
        return (record, "sound") if sound else (None, "damaged")

    def _move_away(self, artifact: Artifact) -> None:
        """Take a damaged object out of the way, unless another run has just replaced it."""
        try:
            path = self.locate(artifact)
        except StoreError:
            return
        with file_lock(self.guard):
            if os.path.lexists(path) and self.problem(artifact, thorough=True) is not None:
                path.replace(temporary_name(self.root / "damaged", f"-{path.name}"))

    def compute_once(
        self,
        stage: str,
        version: int,
        key: str,
        function: StageFunction,
        *,
        refresh: bool = False,
        notes: Notes | None = None,
    ) -> tuple[StageRecord, bool]:
        """The record of a key, computed at most once among all processes and threads.

        Args:
            stage: The stage's name.
            version: Its version.
            key: From `tasks.records.stage_key`.
            function: Computes the artifacts and puts them into this store.
            refresh: Compute even where there is a sound record.
            notes: Get what was found damaged.

        Returns:
            The record, and whether this call computed it.

        Raises:
            StoreError: The function returned something else than artifacts of this store and
                JSON values, or asked for its own key.
            Exception: Whatever the function raises; nothing is recorded then.
        """
        notes = notes if notes is not None else Notes()
        if not refresh and (record := self.lookup(stage, key, notes)) is not None:
            return record, False
        with self._only_one(key):
            if not refresh and (record := self._find_here(stage, key, notes)[0]) is not None:
                return record, False  # another run computed it while this one waited
            with self._turn(stage, key, refresh, notes) as record:
                if record is not None:
                    return record, False
                with Measurement() as measured:
                    output = function()
                record = self._make_record(stage, version, key, output, measured)
                self._write_record(record)
                self._share(record, notes)
        return record, True

    @contextmanager
    def _turn(
        self, stage: str, key: str, refresh: bool, notes: Notes
    ) -> Iterator[StageRecord | None]:
        """Held while a key is computed; the record, where a machine elsewhere made it meanwhile."""
        yield None

    def _share(self, record: StageRecord, notes: Notes) -> None:
        """Called with each record that was computed."""

    @contextmanager
    def _only_one(self, key: str) -> Iterator[None]:
        path = self.lock_path(key)
        held: set[Path] = _held.__dict__.setdefault("paths", set())
        if path in held:
            raise StoreError(f"the stage with key {key} asks for its own result")
        with file_lock(path):
            os.utime(path)  # the garbage collector spares what is newer than a held lock
            held.add(path)
            try:
                yield
            finally:
                held.discard(path)

    def _make_record(
        self,
        stage: str,
        version: int,
        key: str,
        output: StageOutput | Mapping[str, Artifact],
        measured: Measurement,
    ) -> StageRecord:
        if not isinstance(output, StageOutput):
            output = StageOutput(output)
        if not isinstance(output.artifacts, Mapping) or not all(
            isinstance(name, str) and isinstance(artifact, Artifact)
            for name, artifact in output.artifacts.items()
        ):
            raise StoreError(
                f"stage {stage} returned {type(output.artifacts).__name__}"
                " (accepted: a dict from names to artifacts, or a StageOutput)"
            )
        for name, artifact in output.artifacts.items():
            path = self.locate(artifact)
            if not path.is_file():
                raise StoreError(f"stage {stage}: artifact {name!r} is not in the store: {path}")
        canonical_json(dict(output.detail), name=f"detail of stage {stage}")
        try:
            return StageRecord(
                stage=stage,
                version=version,
                key=key,
                artifacts=dict(output.artifacts),
                seconds=measured.seconds,
                cpu_seconds=measured.cpu_seconds,
                peak_bytes=measured.peak_bytes,
                peak_of=measured.peak_of,
                created=datetime.now(UTC).isoformat(timespec="milliseconds"),
                detail=dict(output.detail),
            ).with_checksum()
        except ValidationError as error:
            raise StoreError(f"stage {stage}: {error}") from error

    def _write_record(self, record: StageRecord) -> None:
        text = canonical_json(record.to_json(), name=f"record of {record.stage}")
        with file_lock(self.guard, shared=True):
            write_atomically(self.record_path(record.stage, record.key), text, self.temporary)

    def records(self) -> Iterator[tuple[Path, StageRecord | None]]:
        """Every record file with its record; None where it cannot be read."""
        for path in sorted((self.root / "records").glob("*/*.json")):
            try:
                yield path, StageRecord.from_json(path.read_bytes())
            except (StoreError, OSError):
                yield path, None
