"""kill -9 of ``gvr run`` at random moments, with a real Prefect server and a real MLflow store."""

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from faults import children
from faults.checks import losses_after, losses_before
from faults.command_line import CommandLine
from faults.injection import WritePoints
from faults.lines import Line
from faults.mlflow_level import sync_losses


def moments(count: int, seconds: float, rng: np.random.Generator) -> list[float]:
    """Random moments, one in each of so many equal parts of a time, in random order."""
    chosen = (np.arange(count) + rng.random(count)) / count * seconds
    return [float(moment) for moment in rng.permutation(chosen)]


def run_seconds(line: CommandLine, times: int) -> float:
    """Median wall seconds of an undisturbed run in a forked child."""
    taken = []
    for _ in range(times):
        home = line.new_home("timed")
        started = time.monotonic()
        line.finish(home)
        taken.append(time.monotonic() - started)
    return float(np.median(taken))


def kill_runs(
    line: CommandLine, reference: dict[str, Any], when: Sequence[float], count: Line
) -> None:
    """Kill forked runs at these moments; after each, run again and sync.

    Args:
        line: The command line.
        reference: An undisturbed result.
        when: Seconds after the run's start.
        count: Where tries are counted.
    """
    early = 0
    for moment in when:
        home = line.new_home("killed")
        child = children.start(line.run(home))
        early += not child.kill_after(moment)
        child.wait()
        count.add(_losses(line, home, reference), f"after {moment:.2f} s")
    if early:
        count.note = f"{early} had ended before"


def kill_processes(
    line: CommandLine, reference: dict[str, Any], when: Sequence[float], count: Line
) -> None:
    """The same with ``python -m flows run`` in processes of their own."""
    early = 0
    for moment in when:
        home = line.new_home("killed")
        process = line.start_process(home)
        try:
            process.communicate(timeout=moment)
            early += 1
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
        count.add(_losses(line, home, reference), f"process, after {moment:.2f} s")
    if early:
        count.note = f"{early} had ended before"


def write_points(line: CommandLine) -> list[str]:
    """The names of all write points of an undisturbed run under Prefect, but for MLflow's."""
    home, log = line.new_home("counted"), line.folder / "points-of-gvr.txt"

    def count() -> None:
        with log.open("w") as file:
            roots = (home / "store", home / "results")
            WritePoints(roots, note=lambda name: print(name, file=file, flush=True)).install()
            line.run(home)()

    ended = children.run(count, timeout=300)
    if ended.code != 0:
        raise RuntimeError(f"the undisturbed run failed: {ended.output[-500:]}")
    return log.read_text().splitlines()


def kill_at_points(
    line: CommandLine,
    reference: dict[str, Any],
    names: Sequence[str],
    points: Sequence[int],
    count: Line,
) -> None:
    """Kill forked runs at these write points; after each, run again and sync.

    Args:
        line: The command line.
        reference: An undisturbed result.
        names: Of all write points.
        points: Which to try, from 1.
        count: Where tries are counted.
    """
    for point in points:
        home = line.new_home("killed")

        def disturbed(home: Path = home, point: int = point) -> None:
            WritePoints((home / "store", home / "results"), kill_at=point).install()
            line.run(home)()

        ended = children.run(disturbed, timeout=300)
        losses = [] if ended.killed else [f"the run was not killed: {ended.last_line}"]
        losses += _losses(line, home, reference)
        count.add(losses, f"point {point} ({names[point - 1]})")


def _losses(line: CommandLine, home: Path, reference: dict[str, Any]) -> list[str]:
    store, results = home / "store", home / "results"
    losses = losses_before(results, reference)
    said: list[str] = []

    def again() -> Path:
        result, output = line.finish(home)
        said.append(output)
        return result

    losses += losses_after(store, results, reference, again)
    if said and "MLflow was not filled" in said[0]:
        losses.append(f"the next run did not fill MLflow: {said[0][-300:]}")
    losses += sync_losses(line, home)
    shutil.rmtree(home)
    return losses
