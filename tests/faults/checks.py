"""What must hold after a fault."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from faults.work import comparable, difference
from gvr_core.errors import GVRError
from gvr_core.locks import file_lock
from reports.result_io import check_files, list_results, read_result
from tasks.store import Store

MOST_SECONDS = 120.0
"""A run after a fault that takes longer than this was in somebody's way."""


def losses_before(results: Path, reference: dict[str, Any]) -> list[str]:
    """What is wrong right after a fault: results that are listed must be whole."""
    found = []
    for folder in list_results(results):
        try:
            read_result(folder)
        except GVRError as error:
            found.append(f"a half-written result is listed: {error}")
            continue
        if unlike := difference(reference, comparable(folder)):
            found.append(f"a listed result is not the undisturbed one: {unlike}")
    return found


def losses_after(
    store: Path, results: Path, reference: dict[str, Any], run: Callable[[], Path]
) -> list[str]:
    """What is wrong with the next run, and with what it leaves.

    Args:
        store: The store's folder.
        results: The results' folder.
        reference: An undisturbed result.
        run: Runs the work to its end; returns the result's folder.

    Returns:
        Each thing that does not hold, as a phrase.
    """
    found = []
    try:
        folder = run()
        read_result(folder)
        check_files(folder)
    except Exception as error:
        return [f"the next run failed: {type(error).__name__}: {error}"]
    if unlike := difference(reference, comparable(folder)):
        found.append(f"the next result is not the undisturbed one: {unlike}")
    report = Store(store).verify()
    found += [f"cache verify: {problem.path} {problem.finding}" for problem in report.problems]
    for lock in (store / "locks").glob("*.lock"):
        try:
            with file_lock(lock, timeout=0):
                pass
        except GVRError:
            found.append(f"{lock.name} is still held")
    return found + litter(store, results)


def litter(store: Path, results: Path) -> list[str]:
    """Unfinished files that neither the next run nor ``gvr cache gc`` takes away."""
    Store(store).gc(grace_seconds=0)
    left = [path for name in ("tmp", "damaged") for path in (store / name).glob("*")]
    left += list(results.glob(".*.tmp"))
    found = [f"{path.name} stays for ever" for path in left]
    if not Store(store).verify().sound:
        found.append("cache gc damaged the store")
    return found
