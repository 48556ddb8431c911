"""Upkeep of the shared tier: list it, check it, fill it, and remove what nobody needs."""

from __future__ import annotations

import time
import uuid
from collections.abc import Iterable

from pydantic import BaseModel, ConfigDict

from gvr_core.errors import RemoteError, StoreError
from gvr_core.remote_folder import Entry
from tasks.files import temporary_name
from tasks.findings import Notes
from tasks.records import Artifact, StageRecord
from tasks.remote_tier import FRESH_SECONDS, RECORD_BYTES, RemoteTier
from tasks.shared_store import SharedStore
from tasks.upkeep import GRACE_SECONDS, GcReport, Listing, Problem, VerifyReport, digests_in

SHORTEST_GRACE = 2 * FRESH_SECONDS
"""A writer may rely on an unnamed object for half of this before its record is there."""


class PushReport(BaseModel):
    """What was put into the shared store."""

    model_config = ConfigDict(frozen=True)

    url: str
    pushed: int
    """Records that are there now and were not known to be before."""
    known: int
    """Records that were known to be there."""
    damaged: int
    """Records of the local folder that are not sound, and so were not put."""
    failed: int
    reason: str
    """Why the first of those failed."""


def push_everything(store: SharedStore) -> PushReport:
    """Put every sound local record that is not known to be over there.

    Args:
        store: A store with a URL.

    Raises:
        StoreError: The store has no URL.
    """
    remote = _remote(store)
    pushed = known = damaged = failed = 0
    reason = ""
    for path, record in store.records():
        place = (path.parent.name, path.stem)
        if record is None or (record.stage, record.key) != place or _damaged(store, record):
            damaged += 1
        elif remote.knows(record):
            known += 1
        else:
            notes = Notes()
            if store.push(record, notes):
                pushed += 1
            else:
                failed += 1
                reason = reason or notes.unshared
    return PushReport(
        url=remote.url, pushed=pushed, known=known, damaged=damaged, failed=failed, reason=reason
    )


def list_shared(store: SharedStore) -> Listing:
    """What is in the shared store, by its listing alone: nothing is read.

    Raises:
        StoreError: The store has no URL, or it cannot be listed.
    """
    remote = _remote(store)
    objects = _objects(remote)
    counts: dict[str, int] = {}
    for entry in _records(remote):
        stage = entry.name.split("/")[1]
        counts[stage] = counts.get(stage, 0) + 1
    return Listing(
        root=remote.url,
        records=(),
        unreadable=0,
        objects=len(objects),
        object_bytes=sum(entry.size for entry in objects),
        shared_stages=counts,
    )


def verify_shared(store: SharedStore) -> VerifyReport:
    """Read every record over there, and hash every object that one names.

    What is found damaged is remembered, and put anew by the next push that has it.

    Raises:
        StoreError: The store has no URL, or the other side fails.
    """
    remote = _remote(store)
    problems: list[Problem] = []
    findings: dict[str, str | None] = {}
    records = artifacts = hashed = 0
    for entry in _records(remote):
        records += 1
        stage, key = _stage_and_key(entry)
        notes = Notes()
        record = remote.record(stage, key, notes)
        _must_have_answered(notes)
        for found in notes.findings:
            problems.append(Problem(path=found.path, finding=found.finding))
        for name, artifact in (record.artifacts if record is not None else {}).items():
            artifacts += 1
            if artifact.path not in findings:
                findings[artifact.path] = _object_problem(store, remote, artifact)
                hashed += artifact.bytes
            finding = findings[artifact.path]
            if finding is not None:
                problems.append(
                    Problem(
                        path=artifact.path, finding=finding, stage=stage, key=key, artifact=name
                    )
                )
    orphans = [entry for entry in _objects(remote) if entry.name not in findings]
    return VerifyReport(
        root=remote.url,
        records=records,
        artifacts=artifacts,
        bytes_hashed=hashed,
        problems=tuple(problems),
        orphans=len(orphans),
        orphan_bytes=sum(entry.size for entry in orphans),
    )


def collect_shared_garbage(
    store: SharedStore,
    keep_days: float | None = None,
    *,
    dry_run: bool = False,
    grace_seconds: float = GRACE_SECONDS,
) -> GcReport:
    """Remove from the shared store what no record there refers to.

    No lock reaches over machines, so this goes by age. A writer puts its objects before its
    record, and takes an object that is there for granted only while it is younger than half of
    the shortest grace period; so one that is older than the whole of it and that no record names
    now is relied on by nobody who puts a record within the other half. Records are listed after
    objects and removed before them. Ages are by the other side's clock.

    Args:
        store: A store with a URL.
        keep_days: Also remove records written longer ago. When they were last used is not known.
        dry_run: Only say what would be removed.
        grace_seconds: Spare anything younger.

    Raises:
        StoreError: The store has no URL, the grace period is too short, or the other side fails.
    """
    if grace_seconds < SHORTEST_GRACE or (keep_days is not None and keep_days < 0):
        raise StoreError(
            f"a grace period of {grace_seconds:g} s, records kept for {keep_days} days"
            f" (accepted: {SHORTEST_GRACE:g} s or more, and 0 days or more)"
        )
    remote = _remote(store)
    now = _its_time(remote)
    young = now - grace_seconds
    objects = _objects(remote)
    unfinished = [entry for under in ("tmp", "leases") for entry in remote.folder.entries(under)]
    records = _records(remote)
    oldest = None if keep_days is None else min(now - keep_days * 86400, young)
    old = _older(records, oldest)
    going = {entry.name for entry in old}
    kept = [entry for entry in records if entry.name not in going]
    named = set().union(*(_digests(remote, entry) for entry in kept))
    unnamed = [entry for entry in objects if entry.name[11:75] not in named]
    gone = _older(unnamed, young)
    temporary = _older(unfinished, young)
    if not dry_run:
        # Records first: if this is interrupted, no record is left without its objects.
        for entry in [*old, *gone, *temporary]:
            remote.folder.remove(entry.name)
    return GcReport(
        root=remote.url,
        dry_run=dry_run,
        records=len(old),
        objects=len(gone),
        temporary=len(temporary),
        prefect_results=0,
        locks=0,
        bytes_freed=sum(entry.size for entry in [*old, *gone, *temporary]),
        spared=len(unnamed) - len(gone),
        removed=tuple(entry.name for entry in [*old, *gone]),
    )


def _remote(store: SharedStore) -> RemoteTier:
    if store.remote is None:
        raise StoreError(
            f"{store.root} is not shared by URL (accepted: --store or GVR_STORE as a URL)"
        )
    return store.remote


def _damaged(store: SharedStore, record: StageRecord) -> bool:
    return any(store.problem(artifact) is not None for artifact in record.artifacts.values())


def _records(remote: RemoteTier) -> list[Entry]:
    return [entry for entry in remote.folder.entries("records") if remote.is_record(entry.name)]


def _objects(remote: RemoteTier) -> list[Entry]:
    return [entry for entry in remote.folder.entries("objects") if remote.is_object(entry.name)]


def _stage_and_key(entry: Entry) -> tuple[str, str]:
    _, stage, file = entry.name.split("/")
    return stage, file.removesuffix(".json")


def _must_have_answered(notes: Notes) -> None:
    """A failure of the other side, which a run only notes, is an error here."""
    if notes.unshared:
        raise RemoteError(notes.unshared)


def _object_problem(store: SharedStore, remote: RemoteTier, artifact: Artifact) -> str | None:
    """What is wrong with an object over there; it is copied here for a moment and hashed."""
    try:
        store.locate(artifact)
    except StoreError as error:
        return str(error)
    notes = Notes()
    temporary = temporary_name(store.temporary, ".verified")
    try:
        remote.fetch(artifact, temporary, notes)
        _must_have_answered(notes)
    finally:
        temporary.unlink(missing_ok=True)
    return notes.findings[0].finding if notes.findings else None


def _digests(remote: RemoteTier, entry: Entry) -> set[str]:
    """All digests in a record, also in one that cannot be read or is too long for a record."""
    text = remote.folder.read(entry.name, max(RECORD_BYTES, entry.size))
    return digests_in(text or b"")


def _older(entries: Iterable[Entry], than: float | None) -> list[Entry]:
    if than is None:
        return []
    return [e for e in entries if e.modified is not None and e.modified < than]


def _its_time(remote: RemoteTier) -> float:
    """The other side's clock, read off a file written now; ours where it does not say."""
    name = f"tmp/{uuid.uuid4().hex}"
    remote.folder.write(name, b"what time is it?")
    entry = remote.folder.entry(name)
    remote.folder.remove(name)
    return time.time() if entry is None or entry.modified is None else entry.modified
