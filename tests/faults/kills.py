"""kill -9 at write points, at each of them in turn."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from faults import children
from faults.checks import MOST_SECONDS, losses_after, losses_before
from faults.injection import WritePoints
from faults.lines import Line
from faults.work import Work, emptied
from reports.result_io import list_results


def write_points(work: Work, folder: Path) -> list[str]:
    """The names of all write points of an undisturbed run, in order."""
    log = folder / "points.txt"
    store, results = _places(emptied(folder / "counted"))

    def count() -> None:
        with log.open("w") as file:
            points = WritePoints((store, results), note=lambda name: print(name, file=file))
            points.install()
            work.run(store, results)

    ended = children.run(count)
    if ended.code != 0:
        raise RuntimeError(f"the undisturbed run failed: {ended.last_line}")
    return log.read_text().splitlines()


def kill_at_points(
    work: Work,
    folder: Path,
    reference: dict[str, Any],
    names: Sequence[str],
    points: Sequence[int],
    line: Line,
) -> None:
    """Kill a run at each of some points, run again, and count what was lost.

    Args:
        work: The work.
        folder: For stores and results.
        reference: An undisturbed result.
        names: Of all points.
        points: Which to try, from 1.
        line: Where they are counted.
    """
    longest = 0.0
    for point in points:
        store, results = _places(emptied(folder / "killed"))

        def disturbed(store: Path = store, results: Path = results, point: int = point) -> None:
            WritePoints((store, results), kill_at=point).install()
            work.run(store, results)

        where = f"point {point} ({names[point - 1]})"
        ended = children.run(disturbed)
        if not ended.killed:
            line.add([f"the run was not killed: {ended.last_line}"], where)
            continue
        losses = losses_before(results, reference)
        started = time.monotonic()
        losses += losses_after(store, results, reference, partial(again, work, store, results))
        longest = max(longest, time.monotonic() - started)
        if longest > MOST_SECONDS:
            losses.append(f"the next run took {longest:.0f} s")
        line.add(losses, where)
    line.note = f"next run at most {longest:.1f} s"


def again(work: Work, store: Path, results: Path) -> Path:
    """Run the work to its end in a child of its own; returns the newest result.

    Raises:
        RuntimeError: The run failed.
    """
    known = set(list_results(results))
    ended = children.run(lambda: work.run(store, results), timeout=MOST_SECONDS)
    if ended.code != 0:
        raise RuntimeError(ended.last_line)
    (folder,) = set(list_results(results)) - known
    return folder


def _places(folder: Path) -> tuple[Path, Path]:
    return folder / "store", folder / "results"
