"""Upkeep of the artifact store: list it, check it, and remove what nobody needs."""

from __future__ import annotations

import re
import time
from collections.abc import Iterable
from contextlib import nullcontext
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from gvr_core.errors import StoreError
from gvr_core.locks import file_lock, remove_if_free
from tasks.record_store import RecordStore
from tasks.records import DIGEST

GRACE_SECONDS = 24 * 3600.0
"""Objects are put before the record that names them: none younger than this is removed."""

_DIGESTS = re.compile(DIGEST.pattern.encode())
_FETCHING = re.compile(r"fetch-[0-9a-f]{2}")
"""Locks held while results come from a shared store; a few for all keys, and kept."""


class _Report(BaseModel):
    model_config = ConfigDict(frozen=True)


class RecordLine(_Report):
    """One record in a listing."""

    stage: str
    version: int
    key: str
    created: str
    seconds: float
    cpu_seconds: float
    peak_bytes: int
    bytes: int
    """Size of its artifacts."""
    artifacts: int
    """Number of its artifacts."""


class Listing(_Report):
    """What is in the store."""

    root: str
    records: tuple[RecordLine, ...]
    """Newest first."""
    unreadable: int
    """Record files that are no record of this schema."""
    objects: int
    """Object files, of all stages."""
    object_bytes: int
    shared_stages: dict[str, int] = Field(default_factory=dict)
    """Number of records by stage, where they were counted by their names and not read."""

    @property
    def stages(self) -> dict[str, int]:
        """Number of records by stage, in alphabetical order."""
        if self.shared_stages:
            return dict(sorted(self.shared_stages.items()))
        names = sorted(line.stage for line in self.records)
        return {name: names.count(name) for name in dict.fromkeys(names)}


class Problem(_Report):
    """Something wrong that a check found."""

    path: str
    """The record or object, relative to the store."""
    finding: str
    stage: str | None = None
    key: str | None = None
    artifact: str | None = None
    """The artifact's name in its record."""


class VerifyReport(_Report):
    """What a check of the whole store found."""

    root: str
    records: int
    artifacts: int
    """Artifacts named by readable records."""
    bytes_hashed: int
    problems: tuple[Problem, ...]
    orphans: int
    """Objects that no record names: left by a stage that failed, or put outside of stages."""
    orphan_bytes: int

    @property
    def sound(self) -> bool:
        """Whether nothing is wrong; orphans are not wrong."""
        return not self.problems


class GcReport(_Report):
    """What was removed, or would be."""

    root: str
    dry_run: bool
    records: int
    objects: int
    temporary: int
    """Unfinished files, and objects moved away as damaged."""
    prefect_results: int
    locks: int
    bytes_freed: int
    spared: int
    """Objects that no record names, kept because they are young or a stage is running."""
    removed: tuple[str, ...]
    """Records and objects, relative to the store."""


def list_records(store: RecordStore, stage: str | None = None) -> Listing:
    """See `tasks.store.Store.ls`."""
    lines: list[RecordLine] = []
    unreadable = 0
    for path, record in store.records():
        if stage is not None and path.parent.name != stage:
            continue
        if record is None:
            unreadable += 1
            continue
        lines.append(
            RecordLine(
                stage=record.stage,
                version=record.version,
                key=record.key,
                created=record.created,
                seconds=record.seconds,
                cpu_seconds=record.cpu_seconds,
                peak_bytes=record.peak_bytes,
                bytes=record.total_bytes,
                artifacts=len(record.artifacts),
            )
        )
    lines.sort(key=lambda line: line.created, reverse=True)
    sizes = [path.lstat().st_size for path in _object_files(store)]
    return Listing(
        root=str(store.root),
        records=tuple(lines),
        unreadable=unreadable,
        objects=len(sizes),
        object_bytes=sum(sizes),
    )


def verify_everything(store: RecordStore) -> VerifyReport:
    """See `tasks.store.Store.verify`."""
    problems: list[Problem] = []
    findings: dict[str, str | None] = {}
    records = artifacts = hashed = 0
    for path, record in store.records():
        records += 1
        place = path.relative_to(store.root).as_posix()
        if record is None:
            problems.append(Problem(path=place, finding="is not a stage record of this schema"))
            continue
        if (record.stage, record.key) != (path.parent.name, path.stem):
            problems.append(Problem(path=place, finding="is the record of another stage or key"))
        for name, artifact in record.artifacts.items():
            artifacts += 1
            if artifact.path not in findings:
                findings[artifact.path] = store.problem(artifact, thorough=True)
                hashed += artifact.bytes
            finding = findings[artifact.path]
            if finding is not None:
                problems.append(
                    Problem(
                        path=artifact.path,
                        finding=finding,
                        stage=record.stage,
                        key=record.key,
                        artifact=name,
                    )
                )
    named = _digests_in(_record_files(store))
    orphans = [path for path in _object_files(store) if path.name[:64] not in named]
    return VerifyReport(
        root=str(store.root),
        records=records,
        artifacts=artifacts,
        bytes_hashed=hashed,
        problems=tuple(problems),
        orphans=len(orphans),
        orphan_bytes=sum(path.lstat().st_size for path in orphans),
    )


def collect_garbage(
    store: RecordStore,
    keep_days: float | None = None,
    *,
    dry_run: bool = False,
    grace_seconds: float = GRACE_SECONDS,
) -> GcReport:
    """Remove what no record refers to.

    An object stays if its digest occurs anywhere in any record file, even in one that cannot be
    read, as a newer version of this program may have written it. Of the rest, those younger than
    ``grace_seconds`` stay, and those younger than the oldest stage that is running now: its
    record is still to come. Writers share a lock that this function takes for itself, so nothing
    is put or looked up between deciding and deleting.

    Args:
        store: The store.
        keep_days: Also remove records that were neither written nor hit for so many days.
        dry_run: Only say what would be removed.
        grace_seconds: Spare anything younger.

    Raises:
        StoreError: A negative number.
    """
    if grace_seconds < 0 or (keep_days is not None and keep_days < 0):
        raise StoreError("keep_days and grace_seconds: negative (accepted: 0 or more)")
    if not store.root.is_dir():
        dry_run = True  # nothing to remove, and nothing to make either
    with nullcontext() if dry_run else file_lock(store.guard):
        now = time.time()
        running, free = _locks(store)
        young = min([now - grace_seconds, *running])
        oldest = None if keep_days is None else min(now - keep_days * 86400, *running, now)
        records = _older(_record_files(store), oldest)
        kept = set(_record_files(store)) - set(records)
        named = _digests_in(kept)
        unnamed = [path for path in _object_files(store) if path.name[:64] not in named]
        objects = _older(unnamed, young)
        temporary = _older([*store.temporary.glob("*"), *(store.root / "damaged").glob("*")], young)
        names = {path.relative_to(store.root / "records") for path in kept}
        results_root = store.root / "prefect-results"
        results = [
            path
            for path in _older(results_root.glob("*/*.json"), young)
            if path.relative_to(results_root) not in names
        ]
        locks = _older(free, young)
        marks = _marks_without_record(store, kept)
        removable = [*records, *objects, *temporary, *results, *marks]
        freed = sum(path.lstat().st_size for path in removable)
        if not dry_run:
            # Records first: if this is interrupted, no record is left without its objects.
            for path in removable:
                path.unlink(missing_ok=True)
    if not dry_run:
        locks = [path for path in locks if remove_if_free(path)]
    return GcReport(
        root=str(store.root),
        dry_run=dry_run,
        records=len(records),
        objects=len(objects),
        temporary=len(temporary),
        prefect_results=len(results),
        locks=len(locks),
        bytes_freed=freed,
        spared=len(unnamed) - len(objects),
        removed=tuple(path.relative_to(store.root).as_posix() for path in [*records, *objects]),
    )


def _marks_without_record(store: RecordStore, records: Iterable[Path]) -> list[Path]:
    """What is known of shared stores (`tasks.remote_tier`) about records that are not here."""
    here = {(path.parent.name, path.stem) for path in records}
    marks = sorted((store.root / "shared").glob("*/known/*/*"))
    return [path for path in marks if (path.parent.name, path.name) not in here]


def _locks(store: RecordStore) -> tuple[list[float], list[Path]]:
    """When the stages that run now began (seconds since the epoch), and the free lock files."""
    running: list[float] = []
    free: list[Path] = []
    for path in sorted((store.root / "locks").glob("*.lock")):
        if not DIGEST.fullmatch(path.stem) and not _FETCHING.fullmatch(path.stem):
            continue
        try:
            began = path.stat().st_mtime
            with file_lock(path, timeout=0):
                if DIGEST.fullmatch(path.stem):
                    free.append(path)
        except StoreError:
            running.append(began)
        except FileNotFoundError:
            continue
    return running, free


def _older(paths: Iterable[Path], than: float | None) -> list[Path]:
    """Those files last changed before a time (seconds since the epoch); none where it is None."""
    if than is None:
        return []
    return [path for path in paths if path.is_file() and path.lstat().st_mtime < than]


def _record_files(store: RecordStore) -> list[Path]:
    return sorted((store.root / "records").glob("*/*.json"))


def _object_files(store: RecordStore) -> list[Path]:
    files = sorted((store.root / "objects").glob("??/*"))
    return [path for path in files if DIGEST.fullmatch(path.name[:64]) and path.is_file()]


def _digests_in(records: Iterable[Path]) -> set[str]:
    return set().union(*(digests_in(path.read_bytes()) for path in records))


def digests_in(record: bytes) -> set[str]:
    """Everything in a record's text that could be a digest, whether it can be read or not."""
    return {match.decode() for match in _DIGESTS.findall(record)}
