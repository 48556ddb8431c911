"""What ``gvr cache`` does; each function is one command, usable without a shell."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from gvr_core.errors import RemoteError
from tasks.store import GcReport, Store, VerifyReport

console = Console()


def cache_ls(root: Path | str, stage: str | None) -> None:
    """``gvr cache ls``."""
    store = Store(root)
    listing = store.ls(stage)
    table = Table("stage", "results", "computed in", "size", box=None)
    for name, count in listing.stages.items():
        lines = [line for line in listing.records if line.stage == name]
        table.add_row(
            name,
            str(count),
            f"{sum(line.seconds for line in lines):.1f} s",
            _size(sum(line.bytes for line in lines)),
        )
    console.print(table)
    _say(f"{listing.objects} objects, {_size(listing.object_bytes)}, in {store.root}")
    if listing.unreadable:
        _say(f"{listing.unreadable} records cannot be read and will be computed again")
    if store.remote is None:
        return
    shared = store.ls_shared()
    counts = {n: c for n, c in shared.stages.items() if stage is None or n == stage}
    named = ", ".join(f"{name} {count}" for name, count in counts.items()) or "no results"
    _say(f"Shared: {named}; {shared.objects} objects, {_size(shared.object_bytes)}, in {store.url}")


def cache_verify(root: Path | str, remote: bool = False) -> int:
    """``gvr cache verify``; exit code 1 where something is damaged."""
    store = Store(root)
    reports = [store.verify()]
    if remote:
        reports.append(store.verify_shared())
    for report in reports:
        _say_verified(report)
    return 0 if all(report.sound for report in reports) else 1


def _say_verified(report: VerifyReport) -> None:
    for problem in report.problems:
        _say(f"{problem.path}: {problem.finding}")
    _say(
        f"{report.records} results, {report.artifacts} artifacts, "
        f"{_size(report.bytes_hashed)} read, {len(report.problems)} problems, "
        f"{report.orphans} objects that no result names, in {report.root}"
    )


def cache_push(root: Path | str) -> int:
    """``gvr cache push``; exit code 1 where something could not be put."""
    store = Store(root)
    store.check()
    report = store.push_all()
    _say(
        f"{report.pushed} results put, {report.known} were there, {report.damaged} damaged here, "
        f"{report.failed} failed; {report.url}"
    )
    if report.failed:
        raise RemoteError(f"not everything is shared: {report.reason}")
    return 0


def cache_gc(
    root: Path | str, keep_days: float | None, dry_run: bool, remote: bool = False
) -> None:
    """``gvr cache gc``, in the local folder or in the shared store."""
    store = Store(root)
    report: GcReport = (store.gc_shared if remote else store.gc)(keep_days, dry_run=dry_run)
    verb = "would go" if report.dry_run else "removed"
    _say(
        f"{verb}: {report.records} results, {report.objects} objects, "
        f"{report.temporary} unfinished files; {_size(report.bytes_freed)}. "
        f"{report.spared} young objects spared."
    )


def _say(text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count < 1e9 else f"{count / 1e9:.2f} GB"
