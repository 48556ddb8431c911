"""Several runs at once on one store: each artifact is computed by one of them."""

from __future__ import annotations

import os
import signal
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from faults import children
from faults.checks import litter
from faults.lines import Line
from faults.work import Work, comparable, difference, emptied
from reports.result_io import list_results
from tasks.record_store import RecordStore


def race(
    work: Work,
    folder: Path,
    reference: dict[str, Any],
    runs: int,
    line: Line,
    kill_in: str | None = None,
) -> None:
    """Start runs at the same moment, and count who computed what.

    Args:
        work: The work.
        folder: For the store and the results.
        reference: An undisturbed result.
        runs: How many.
        line: Where the try is counted.
        kill_in: Whoever computes this stage first is killed there; the others are to finish.
    """
    place = emptied(folder / "race")
    log, store, results = place / "log.txt", place / "store", place / "results"
    log.touch()
    gate, opener = os.pipe()

    def one() -> None:
        os.close(opener)
        os.read(gate, 1)  # until the other end is closed
        _log_computations(log, kill_in)
        work.run(store, results)

    started = [children.start(one) for _ in range(runs)]
    os.close(opener)
    ended = [child.wait() for child in started]
    os.close(gate)
    losses = [end.last_line for end in ended if end.code != 0 and not end.killed]
    if sum(end.killed for end in ended) != (kill_in is not None):
        losses.append("not the one run was killed that was to be")
    computed = Counter(log.read_text().splitlines())
    stages = len(list((store / "records").glob("*/*.json")))
    twice = [name for name, count in computed.items() if count != 1]
    losses += [f"{name} was computed {computed[name]} times" for name in twice]
    if len(computed) != stages:
        losses.append(f"{len(computed)} computations for {stages} records")
    folders = list_results(results)
    if len(folders) != runs - (kill_in is not None):
        losses.append(f"{len(folders)} results of {runs} runs")
    for result in folders:
        if unlike := difference(reference, comparable(result)):
            losses.append(f"{result.name} is not the undisturbed one: {unlike}")
    losses += litter(store, results)
    line.add(losses, f"{runs} runs")


def _log_computations(log: Path, kill_in: str | None) -> None:
    """Note each computation that came to its end, in one write; two of a stage are two lines."""
    real = RecordStore.compute_once
    mark = log.with_suffix(".killed")

    def compute_once(
        store: RecordStore, stage: str, version: int, key: str, function: Any, **named: Any
    ) -> Any:
        return real(store, stage, version, key, _noted(stage, key, function), **named)

    def _noted(stage: str, key: str, function: Callable[[], Any]) -> Callable[[], Any]:
        def noted() -> Any:
            output = function()
            if stage == kill_in and _first(mark):
                os.kill(os.getpid(), signal.SIGKILL)
            with log.open("ab", buffering=0) as file:
                file.write(f"{stage} {key[:12]}\n".encode())
            return output

        return noted

    RecordStore.compute_once = compute_once  # type: ignore[method-assign]


def _first(mark: Path) -> bool:
    try:
        mark.open("x").close()
    except FileExistsError:
        return False
    return True
