"""Disks that are full: small ones made in memory, for the store and for the results."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from faults import children
from faults.checks import losses_after, losses_before
from faults.command_line import CommandLine
from faults.kills import again
from faults.lines import Line
from faults.mlflow_level import sync_losses
from faults.work import Work, emptied
from tasks.store import Store

PLENTY = "size=64m,nr_inodes=10000"
PAGE = 4096


def may_mount() -> bool:
    """Whether this process may mount a file system."""
    return os.geteuid() == 0 and _mounts(["mount", "-t", "tmpfs", "tmpfs", "/mnt"])


@contextmanager
def small_disk(folder: Path, options: str) -> Iterator[Path]:
    """A disk in memory, mounted on a folder.

    Args:
        folder: Made where missing; its own content is hidden meanwhile.
        options: Of tmpfs: ``size=100k``, ``nr_inodes=10``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def free_space(folder: Path) -> None:
    """Give a small disk plenty of room."""
    subprocess.run(["mount", "-o", f"remount,{PLENTY}", str(folder)], check=True)


def occupied(folder: Path) -> int:
    """Bytes that a folder's files take on such a disk."""
    sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
    return sum(-(-size // PAGE) * PAGE for size in sizes)


def sizes_up_to(most: int, steps: int) -> list[int]:
    """Sizes of disks, from next to nothing to just too small."""
    pages = most // PAGE
    return sorted({max(1, round(pages * (step + 1) / (steps + 1))) * PAGE for step in range(steps)})


def fill_disk(
    work: Work,
    folder: Path,
    reference: dict[str, Any],
    small: str,
    options: Sequence[str],
    line: Line,
) -> None:
    """Run on disks that are too small; then give them room, and run again.

    Args:
        work: The work.
        folder: For stores and results.
        reference: An undisturbed result.
        small: Which folder the disk is for: ``"store"`` or ``"results"``.
        options: Of each disk.
        line: Where tries are counted.
    """
    for option in options:
        place = emptied(folder / "full")
        store, results = place / "store", place / "results"
        with small_disk(place / small, option):
            ended = children.run(partial(work.run, store, results))
            losses = []
            if ended.code == 0:
                losses.append("the disk was large enough")
            losses += message_losses(ended.output, place / small)
            losses += losses_before(results, reference) if small == "results" else []
            if store.is_dir():
                problems = Store(store).verify().problems
                losses += [
                    f"cache verify: {problem.path} {problem.finding}" for problem in problems
                ]
            free_space(place / small)
            losses += losses_after(store, results, reference, partial(again, work, store, results))
            line.add(losses, option)


def fill_disk_of_runs(
    line: CommandLine,
    reference: dict[str, Any],
    small: str,
    sizes: Sequence[int],
    count: Line,
) -> None:
    """The same for ``gvr run``: its exit code, what it says, and MLflow afterwards.

    Args:
        line: The command line.
        reference: An undisturbed result.
        small: Which folder of the home the disk is for: ``"store"``, ``"results"``, ``"mlflow"``.
        sizes: Of each disk, bytes; for MLflow beside its empty store.
        count: Where tries are counted.
    """
    for size in sizes:
        home = line.new_home("full-home")
        database = line.empty_mlflow.database
        room = size + (occupied(database.parent) if small == "mlflow" else 0)
        with small_disk(home / small, f"size={room}"):
            if small == "mlflow":
                shutil.copy(database, home / "mlflow" / "mlflow.db")
            ended = children.run(line.run(home), timeout=300)
            # A result that MLflow does not hold is whole, and the run went well.
            expected = 0 if small == "mlflow" else 1
            losses = []
            if ended.code != expected:
                losses.append(f"exit code {ended.code}: {ended.output.strip()[-300:]}")
            if small != "mlflow":
                losses += message_losses(ended.output, home / small)
            elif "Traceback" in ended.output or not re.search(
                r"MLflow was not filled: .*(no space left|disk is full)", ended.output
            ):
                losses.append(f"no word of it: {ended.output.strip()[-300:]}")
            if small != "store":  # else the result lists a scene that failed, as it should
                losses += losses_before(home / "results", reference)
            free_space(home / small)
            losses += losses_after(
                home / "store", home / "results", reference, partial(_result, line, home)
            )
            if small == "mlflow":
                losses += sync_losses(line, home)
            count.add(losses, f"{size:,} bytes")


def _result(line: CommandLine, home: Path) -> Path:
    return line.finish(home)[0]


def message_losses(output: str, place: Path) -> list[str]:
    """What is wrong with the message about a full disk."""
    if "Traceback" in output:
        return [f"a traceback: {output.strip().splitlines()[-1]}"]
    about = [text for text in output.splitlines() if "no space left" in text]
    if not about:
        return [f"no word of it: {output.strip()[-300:]}"]
    if not any(str(place) in text and re.search(r"\d bytes free", text) for text in about):
        return [f"neither place nor free bytes: {about[0]}"]
    return []


def _mounts(command: list[str]) -> bool:
    done = subprocess.run(command, capture_output=True, check=False)
    if done.returncode == 0:
        subprocess.run(["umount", command[-1]], check=True)
    return done.returncode == 0
