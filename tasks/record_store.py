"""Records of what stages computed: the upper half of the artifact store."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from pydantic import JsonValue, ValidationError

from gvr_core.errors import StoreError
from gvr_core.locks import file_lock
from tasks.files import storing, temporary_name, write_atomically
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


@dataclass
class LookupCounts:
    """How the look-ups of one `Store` object ended."""

    hits: int = 0
    misses: int = 0
    """All that were not hits, the next two included."""
    damaged: int = 0
    """A record whose artifact was missing, truncated or of another content."""
    unreadable: int = 0
    """A record that was no JSON, of another schema, or of another stage or key."""


class RecordStore(ObjectStore):
    """Objects and stage records in one folder, for any number of processes and threads.

    Args:
        root: The store's folder; else the environment variable GVR_STORE, else ``.gvr/store``
            under the current folder. Made at the first write.
    """

    def __init__(self, root: Path | str | None = None) -> None:
        super().__init__(root)
        self.counts = LookupCounts()

    def __reduce__(self) -> tuple[type[RecordStore], tuple[Path]]:
        # Sent to another process, a store starts with nothing checked and nothing counted.
        return type(self), (self.root,)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self.root)!r})"

    def record_path(self, stage: str, key: str) -> Path:
        """Where the record of a stage and key lies.

        Raises:
            StoreError: The name or the key is not one.
        """
        return self.root / "records" / check_stage_name(stage) / f"{check_key(key)}.json"

    def lock_path(self, key: str) -> Path:
        """The file that is locked while a key is computed."""
        return self.root / "locks" / f"{check_key(key)}.lock"

    def lookup(self, stage: str, key: str) -> StageRecord | None:
        """The record of a stage and key, if it and all its artifacts are sound.

        A hit renews the record's time stamp, which `tasks.upkeep.gc` goes by. A damaged object
        is moved to ``damaged/``, so that the stage is computed again; its record is left to be
        replaced by that.

        Returns:
            The record, or None. `counts` tells the kinds of None apart.

        Raises:
            StoreError: The name or the key is not one.
        """
        record, finding = self._find(stage, key)
        if record is not None:
            self.counts.hits += 1
            return record
        self.counts.misses += 1
        self.counts.damaged += finding == "damaged"
        self.counts.unreadable += finding == "unreadable"
        return None

    def _find(self, stage: str, key: str) -> tuple[StageRecord | None, str]:
        path = self.record_path(stage, key)
        if not path.exists():
            return None, "none"
        try:
            with file_lock(self.guard, shared=True):
                os.utime(path)
                text = path.read_bytes()
        except OSError:
            return None, "none"
        try:
            record = StageRecord.from_json(text)
        except StoreError:
            return None, "unreadable"
        if (record.stage, record.key) != (stage, key):
            return None, "unreadable"
        sound = True
        for artifact in record.artifacts.values():
            if self.problem(artifact) is not None:
                sound = False
                self._move_away(artifact)
        return (record, "") if sound else (None, "damaged")

    def _move_away(self, artifact: Artifact) -> None:
        """Take a damaged object out of the way, unless another run has just replaced it."""
        try:
            path = self.locate(artifact)
        except StoreError:
            return
        with storing(self.root), file_lock(self.guard):
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
    ) -> tuple[StageRecord, bool]:
        """The record of a key, computed at most once among all processes and threads.

        Args:
            stage: The stage's name.
            version: Its version.
            key: From `tasks.records.stage_key`.
            function: Computes the artifacts and puts them into this store.
            refresh: Compute even where there is a sound record.

        Returns:
            The record, and whether this call computed it.

        Raises:
            StoreError: The function returned something else than artifacts of this store and
                JSON values, or asked for its own key.
            Exception: Whatever the function raises; nothing is recorded then.
        """
        if not refresh and (record := self.lookup(stage, key)) is not None:
            return record, False
        with self._only_one(key):
            if not refresh and (record := self._find(stage, key)[0]) is not None:
                return record, False  # another run computed it while this one waited
            with Measurement() as measured:
                output = function()
            record = self._make_record(stage, version, key, output, measured)
            self._write_record(record)
        return record, True

    @contextmanager
    def _only_one(self, key: str) -> Iterator[None]:
        path = self.lock_path(key)
        held: set[Path] = _held.__dict__.setdefault("paths", set())
        if path in held:
            raise StoreError(f"the stage with key {key} asks for its own result")
        with ExitStack() as stack:
            with storing(self.root):
                stack.enter_context(file_lock(path))
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
            )
        except ValidationError as error:
            raise StoreError(f"stage {stage}: {error}") from error

    def _write_record(self, record: StageRecord) -> None:
        text = canonical_json(record.to_json(), name=f"record of {record.stage}")
        with storing(self.root), file_lock(self.guard, shared=True):
            write_atomically(self.record_path(record.stage, record.key), text, self.temporary)

    def records(self) -> Iterator[tuple[Path, StageRecord | None]]:
        """Every record file with its record; None where it cannot be read."""
        for path in sorted((self.root / "records").glob("*/*.json")):
            try:
                yield path, StageRecord.from_json(path.read_bytes())
            except (StoreError, OSError):
                yield path, None
