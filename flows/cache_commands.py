"""What ``gvr cache`` does; each function is one command, usable without a shell."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from flows.output import print_document, say, show_sheet
from gvr_core.errors import RemoteError
from reports.sheet import Sheet
from tasks.store import GcReport, Store, VerifyReport


@dataclass(frozen=True)
class CachedStage:
    """The results of one stage."""

    stage: str
    results: int
    seconds: float
    """Wall time that computing them took."""
    bytes: int


@dataclass(frozen=True)
class SharedTier:
    """What the shared store holds."""

    url: str
    stages: dict[str, int]
    """Stage -> results."""
    objects: int
    object_bytes: int


@dataclass(frozen=True)
class CacheDocument:
    """What the artifact store holds."""

    root: str
    stages: tuple[CachedStage, ...]
    objects: int
    object_bytes: int
    unreadable: int
    """Records that cannot be read, and will be computed again."""
    shared: SharedTier | None
    """Null where the store has no URL."""


@dataclass(frozen=True)
class VerifyDocument:
    """What checking the store found; the shared one second."""

    sound: bool
    tiers: tuple[VerifyReport, ...]


def cache_ls(root: Path | str, stage: str | None, as_json: bool = False) -> None:
    """``gvr cache ls``."""
    document = _listing(Store(root), stage)
    if as_json:
        print_document("cache ls", document)
        return
    rows = [
        (line.stage, str(line.results), f"{line.seconds:.1f} s", _size(line.bytes))
        for line in document.stages
    ]
    columns = ("stage", "results", "computed in", "size")
    show_sheet(Sheet(f"results in {document.root}", columns, tuple(rows), n_names=1))
    say(f"{document.objects} objects, {_size(document.object_bytes)}, in {document.root}")
    if document.unreadable:
        say(f"{document.unreadable} records cannot be read and will be computed again")
    if document.shared is not None:
        shared = document.shared
        counts = ", ".join(f"{name} {count}" for name, count in shared.stages.items())
        say(
            f"Shared: {counts or 'no results'}; {shared.objects} objects, "
            f"{_size(shared.object_bytes)}, in {shared.url}"
        )


def _listing(store: Store, stage: str | None) -> CacheDocument:
    listing = store.ls(stage)
    stages = []
    for name, count in listing.stages.items():
        lines = [line for line in listing.records if line.stage == name]
        seconds = sum(line.seconds for line in lines)
        stages.append(CachedStage(name, count, seconds, sum(line.bytes for line in lines)))
    shared = None
    if store.remote is not None:
        there = store.ls_shared()
        counts = {n: c for n, c in there.stages.items() if stage is None or n == stage}
        shared = SharedTier(str(store.url), counts, there.objects, there.object_bytes)
    return CacheDocument(
        root=str(store.root),
        stages=tuple(stages),
        objects=listing.objects,
        object_bytes=listing.object_bytes,
        unreadable=listing.unreadable,
        shared=shared,
    )


def cache_verify(root: Path | str, remote: bool = False, as_json: bool = False) -> int:
    """``gvr cache verify``; exit code 1 where something is damaged."""
    store = Store(root)
    reports = [store.verify()]
    if remote:
        reports.append(store.verify_shared())
    sound = all(report.sound for report in reports)
    if as_json:
        print_document("cache verify", VerifyDocument(sound, tuple(reports)))
    else:
        for report in reports:
            _say_verified(report)
    return 0 if sound else 1


def _say_verified(report: VerifyReport) -> None:
    for problem in report.problems:
        say(f"{problem.path}: {problem.finding}")
    say(
        f"{report.records} results, {report.artifacts} artifacts, "
        f"{_size(report.bytes_hashed)} read, {len(report.problems)} problems, "
        f"{report.orphans} objects that no result names, in {report.root}"
    )


def cache_push(root: Path | str, as_json: bool = False) -> int:
    """``gvr cache push``; exit code 1 where something could not be put."""
    store = Store(root)
    store.check()
    report = store.push_all()
    if as_json:
        print_document("cache push", report)
    else:
        say(
            f"{report.pushed} results put, {report.known} were there, {report.damaged} damaged "
            f"here, {report.failed} failed; {report.url}"
        )
    if report.failed:
        raise RemoteError(f"not everything is shared: {report.reason}")
    return 0


def cache_gc(
    root: Path | str,
    keep_days: float | None,
    dry_run: bool,
    remote: bool = False,
    as_json: bool = False,
) -> None:
    """``gvr cache gc``, in the local folder or in the shared store."""
    store = Store(root)
    report: GcReport = (store.gc_shared if remote else store.gc)(keep_days, dry_run=dry_run)
    if as_json:
        print_document("cache gc", report)
        return
    verb = "would go" if report.dry_run else "removed"
    say(
        f"{verb}: {report.records} results, {report.objects} objects, "
        f"{report.temporary} unfinished files; {_size(report.bytes_freed)}"
    )
    say(f"{report.spared} young objects spared")


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count < 1e9 else f"{count / 1e9:.2f} GB"
