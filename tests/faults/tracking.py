"""A tracking server that is down, slow, silent, cut off or killed while a run fills it."""

from __future__ import annotations

import os
import re
import shutil
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from killable_server import Server
from mlflow_contents import everything, nameless

from faults import children
from faults.checks import losses_before
from faults.command_line import CommandLine
from faults.lines import Line
from faults.mlflow_level import experiment_of, healthy
from faults.proxy import BadLine, proxy
from faults.work import comparable, difference
from reports.mlflow_sink import sync
from reports.mlflow_store import LocalStore
from reports.result_io import list_results

SYNC_SECONDS = 20.0
"""What these syncs may take; those of ``gvr run`` have `reports.mlflow_sink.FILL_SECONDS`."""

CLOSED = "http://127.0.0.1:9"
"""Nobody listens there."""


def new_server(line: CommandLine) -> Server:
    """A real MLflow server over an empty store."""
    folder = line.folder / "served"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(line.empty_mlflow.folder, folder)
    return Server(LocalStore(folder))


def bytes_sent(line: CommandLine, result: Path, url: str) -> int:
    """Bytes that a client sends for one sync, roughly: the least number that does not break it."""
    low, high = 0, 1 << 12
    while not _survives(line, result, url, high):
        low, high = high, high * 2
    return high if low == 0 else (low + high) // 2


def break_syncs(
    line: CommandLine, server: Server, result: Path, bad: Sequence[BadLine], count: Line
) -> None:
    """Sync over bad lines; then over a good one, twice.

    Args:
        line: The command line, for places.
        server: The server; started again where a line has killed it.
        result: The result.
        bad: The lines.
        count: Where tries are counted; its note gets the longest delay.
    """
    expected = healthy(line, [result])
    longest = 0.0
    for number, kind in enumerate(bad):
        url = server.start().url
        # Group of the process that the server runs in: `start_server` gives it one of its own.
        kind = BadLine(kind.delay, kind.after, kind.then, server.start().process.pid)
        experiment = f"{count.fault} {number}"
        started = time.monotonic()
        with proxy(url, kind) as bad_url:
            filling = partial(sync, result, bad_url, experiment, SYNC_SECONDS)
            ended = children.run(filling, timeout=120)
        longest = max(longest, time.monotonic() - started)
        losses = []
        if ended.code not in (0, 1) or "Traceback" in ended.output:
            losses.append(f"exit code {ended.code}: {ended.output[-300:]}")
        elif ended.code == 1 and "is safe" not in ended.output:
            losses.append(f"no word that the result is safe: {ended.last_line}")
        if kind.then == "kill" and kind.after is not None:
            server.kill()
        url = server.start().url
        found: list[list[str]] = []
        for _ in range(2):
            again = children.run(partial(sync, result, url, experiment), timeout=120)
            if again.code != 0:
                losses.append(f"the sync after it failed: {again.last_line}")
            found.append(nameless(everything(server.store, experiment)))
        if found[0] != expected:
            losses.append("MLflow does not hold what the result says")
        if found[1] != found[0]:
            losses.append("a second sync changed what MLflow holds")
        count.add(losses, f"{kind.then} after {kind.after} bytes, delay {kind.delay} s")
    count.note = f"at most {longest:.0f} s until the sync gave up"


def run_against(
    line: CommandLine, url: str, reference: dict[str, Any], ordinary: float, where: str, count: Line
) -> float:
    """``gvr run`` with a tracking server that does not work; returns the seconds it lost by that.

    Args:
        line: The command line.
        url: Of the server.
        reference: An undisturbed result.
        ordinary: Seconds that an undisturbed run takes.
        where: Which server.
        count: Where the try is counted.
    """
    home = line.new_home("untracked")
    started = time.monotonic()
    ended = children.run(line.run(home, "--tracking-uri", url), timeout=600)
    delay = time.monotonic() - started - ordinary
    losses = losses_before(home / "results", reference)
    if ended.code != 0 or "Traceback" in ended.output:
        losses.append(f"exit code {ended.code}: {ended.output.strip()[-500:]}")
    if not re.search(r"MLflow was not filled.*gvr sync", ended.output, re.DOTALL):
        losses.append(f"no word of it: {ended.output.strip()[-300:]}")
    results = list_results(home / "results")
    if len(results) != 1 or difference(reference, comparable(results[0])):
        losses.append("the result is not the undisturbed one")
    else:
        synced = children.run(line.call(home, "sync"), timeout=300)
        filled = nameless(everything(LocalStore(home / "mlflow"), experiment_of(results[0])))
        if synced.code != 0 or filled != healthy(line, results):
            losses.append(f"gvr sync did not bring MLflow level: {synced.last_line}")
    count.add(losses, where)
    return delay


def _survives(line: CommandLine, result: Path, url: str, after: int) -> bool:
    with proxy(url, BadLine(after=after)) as bad:
        name = f"measured {after} {os.getpid()}"
        return children.run(lambda: sync(result, bad, name), timeout=120).code == 0
