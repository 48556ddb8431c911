"""The Prefect server killed in the middle of a run."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from faults import children
from faults.checks import losses_after, losses_before
from faults.command_line import CommandLine, PrefectServer
from faults.lines import Line
from faults.work import Work
from tasks.record_store import RecordStore


def kill_server(
    work: Work, folder: Path, reference: dict[str, Any], stages: Sequence[str], count: Line
) -> None:
    """Kill the server when a stage begins; the next run, with another server, goes on.

    Args:
        work: The work.
        folder: For homes and servers.
        reference: An undisturbed result of the command line.
        stages: At which stages.
        count: Where tries are counted.
    """
    longest = 0.0
    with PrefectServer(folder / "second-server") as second:
        for stage in stages:
            with PrefectServer(folder / "first-server") as first:
                line = CommandLine(work, folder, first.url)
                home = line.new_home("serverless")
                started = time.monotonic()
                ended = children.run(
                    _killing(line.run(home, "--no-mlflow"), stage, first.pids), timeout=590
                )
                longest = max(longest, time.monotonic() - started)
            losses = losses_before(home / "results", reference)
            if ended.code == 1:
                if "Traceback" in ended.output or "Prefect server is lost" not in ended.output:
                    losses.append(f"no clear error: {ended.output.strip()[-300:]}")
            elif ended.code != 0:
                losses.append(f"exit code {ended.code}: {ended.last_line}")
            before = {path: path.read_bytes() for path in home.glob("store/records/*/*.json")}
            if not before:
                losses.append("no stage is in the store")
            other = CommandLine(work, folder, second.url)
            losses += losses_after(
                home / "store", home / "results", reference, partial(_result, other, home)
            )
            if any(path.read_bytes() != text for path, text in before.items()):
                losses.append("the next run computed a stage again that was in the store")
            count.add(losses, f"server killed at {stage}, exit code {ended.code}")
    count.note = f"the run ended within {longest:.0f} s"


def _result(line: CommandLine, home: Path) -> Path:
    return line.finish(home, "--no-mlflow")[0]


def _killing(run: Any, stage: str, pids: Sequence[int]) -> Any:
    def killing() -> None:
        real = RecordStore.compute_once

        def compute_once(store: RecordStore, name: str, *rest: Any, **named: Any) -> Any:
            if name == stage:
                for pid in pids:
                    try:
                        os.kill(pid, signal.SIGKILL)
                    except ProcessLookupError:
                        continue
            return real(store, name, *rest, **named)

        RecordStore.compute_once = compute_once  # type: ignore[method-assign]
        run()

    return killing
