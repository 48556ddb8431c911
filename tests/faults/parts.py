"""The parts of ``benchmarks/reliability.py``: each tries one kind of fault."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from faults import damage, full_disk, kills, memory, races, random_kills, server_loss, tracking
from faults.command_line import CommandLine, PrefectServer
from faults.lines import Line
from faults.proxy import BadLine, proxy
from faults.work import Work, comparable, emptied

IMPORT_SECONDS = 10.0
"""About what the start of Python and all imports take."""


MOUNT = "mounting needs root: unshare -rm python benchmarks/reliability.py"


@dataclass
class Bench:
    """What all parts share."""

    folder: Path
    work: Work
    seed: int
    quick: bool
    kills: int

    @cached_property
    def undisturbed(self) -> Path:
        """The folder of an undisturbed run, with ``store`` and ``results``."""
        folder = emptied(self.folder / "undisturbed")
        kills.again(self.work, folder / "store", folder / "results")
        return folder

    @cached_property
    def server(self) -> PrefectServer:
        """A Prefect server; `close` ends it."""
        return PrefectServer(self.folder / "server")

    @cached_property
    def command_line(self) -> CommandLine:
        """``gvr`` with that server."""
        return CommandLine(self.work, self.folder, self.server.url)

    @cached_property
    def ordinary_seconds(self) -> float:
        """What an undisturbed ``gvr run`` takes, without the start of Python."""
        return random_kills.run_seconds(self.command_line, 1 if self.quick else 3)

    def close(self) -> None:
        """End what was started."""
        if "server" in self.__dict__:
            self.server.stop()

    @cached_property
    def reference(self) -> dict[str, Any]:
        """The result of the undisturbed run."""
        (result,) = (self.undisturbed / "results").glob("[!.]*")
        return comparable(result)


def points(bench: Bench) -> Iterable[Line]:
    """kill -9 at every write point of a run."""
    names = kills.write_points(bench.work, bench.folder)
    everywhere = range(1, len(names) + 1)
    boundaries = [point for point in everywhere if names[point - 1].startswith("stage ")]
    halves = [point for point in everywhere if names[point - 1].startswith("half ")]
    others = [point for point in everywhere if point not in {*boundaries, *halves}]
    for fault, chosen in (
        ("kill -9 at each stage's start, before and after its record", boundaries),
        ("kill -9 half-way through writing each file", halves),
        ("kill -9 before each other change on disk", others),
    ):
        line = Line("points", fault)
        step = -(-len(chosen) // 2) if bench.quick else 1
        kills.kill_at_points(bench.work, bench.folder, bench.reference, names, chosen[::step], line)
        yield line


def runs_at_once(bench: Bench) -> Iterable[Line]:
    """Several runs on one store."""
    everything = (
        (2, None, "two runs at once: each artifact computed once"),
        (4, "masks", "four runs at once, the one that computes killed"),
        (4, None, "four runs at once: each artifact computed once"),
    )
    for runs, kill_in, fault in everything[: 2 if bench.quick else 3]:
        line = Line("races", fault)
        for _ in range(1 if bench.quick else 10):
            races.race(bench.work, bench.folder, bench.reference, runs, line, kill_in)
        yield line


def full(bench: Bench) -> Iterable[Line]:
    """Disks that are too small."""
    small = {"store": "store", "results": "results"}
    for name in small:
        line = Line("disk", f"disk of the {name} full")
        if full_disk.may_mount():
            needed = full_disk.occupied(bench.undisturbed / name)
            sizes = full_disk.sizes_up_to(needed, 1 if bench.quick else 16)
            options = [f"size={size}" for size in sizes]
            files = len(list((bench.undisturbed / name).rglob("*")))
            some = 1 if bench.quick else 5
            options += [f"size=64m,nr_inodes={files * (i + 1) // (some + 1)}" for i in range(some)]
            full_disk.fill_disk(bench.work, bench.folder, bench.reference, name, options, line)
        else:
            line.skipped = MOUNT
        yield line


def full_for_runs(bench: Bench) -> Iterable[Line]:
    """Disks that are too small for ``gvr run``."""
    for name in ("store", "results", "mlflow"):
        line = Line("full-runs", f"`gvr run`, disk of the {name} full")
        if full_disk.may_mount():
            if name == "mlflow":
                sizes = [40960] if bench.quick else [4096 * 4**step for step in range(4)]
            else:
                needed = full_disk.occupied(bench.undisturbed / name)
                sizes = full_disk.sizes_up_to(needed, 1 if bench.quick else 6)
            full_disk.fill_disk_of_runs(bench.command_line, bench.reference, name, sizes, line)
        else:
            line.skipped = MOUNT
        yield line


def damaged(bench: Bench) -> Iterable[Line]:
    """Files that were damaged."""
    ways = ", ".join(damage.DAMAGES)
    lines = {
        "objects": Line("damage", f"artifact {ways}"),
        "records": Line("damage", f"stage record {ways}"),
    }
    damage.damage_store(
        bench.work, bench.folder, bench.reference, lines, bench.seed, 1 if bench.quick else None
    )
    yield from lines.values()
    line = Line("damage", f"file of a result {ways}")
    damage.damage_result(bench.work, bench.folder, line, bench.seed, bench.reference)
    yield line


def out_of_memory(bench: Bench) -> Iterable[Line]:
    """Stages that run out of memory."""
    line = Line("memory", "a stage runs out of memory: its method fails, the next goes on")
    stages = ("masks",) if bench.quick else ("render", "masks", "index", "segment", "evaluate")
    memory.run_out_of_memory(bench.work, bench.folder, stages, line)
    yield line


def random_moments(bench: Bench) -> Iterable[Line]:
    """kill -9 of whole runs at random moments."""
    seconds = bench.ordinary_seconds
    rng = np.random.default_rng(bench.seed)
    line = Line("kills", f"kill -9 of `gvr run` at random within its {seconds:.1f} s")
    when = random_kills.moments(bench.kills, seconds, rng)
    random_kills.kill_runs(bench.command_line, bench.reference, when, line)
    yield line
    line = Line("kills", "kill -9 of `python -m flows run`, start of Python included")
    when = random_kills.moments(max(1, bench.kills // 10), seconds + IMPORT_SECONDS, rng)
    random_kills.kill_processes(bench.command_line, bench.reference, when, line)
    yield line
    names = random_kills.write_points(bench.command_line)
    line = Line("kills", "kill -9 of `gvr run` at write points, those of Prefect's results too")
    some = 1 if bench.quick else 12
    points = [1 + round(len(names) * (i + 0.5) / some) for i in range(some)]
    random_kills.kill_at_points(bench.command_line, bench.reference, names, points, line)
    yield line


def prefect_server(bench: Bench) -> Iterable[Line]:
    """The Prefect server killed in the middle of a run."""
    line = Line("prefect", "Prefect server killed in the middle of a run")
    stages = ("masks",) if bench.quick else ("render", "masks", "query", "segment", "evaluate")
    server_loss.kill_server(bench.work, bench.folder, bench.reference, stages, line)
    yield line


def tracking_server(bench: Bench) -> Iterable[Line]:
    """A tracking server that does not work."""
    line = bench.command_line
    (result,) = (bench.undisturbed / "results").glob("[!.]*")
    server = tracking.new_server(line)
    try:
        url = server.start().url
        down = Line("tracking", "`gvr run` with a tracking server that is down, cut off or silent")
        delays = [
            tracking.run_against(
                line, tracking.CLOSED, bench.reference, bench.ordinary_seconds, "down", down
            )
        ]
        for then in ("cut", "hang"):
            with proxy(url, BadLine(after=4096, then=then)) as bad:
                delays.append(
                    tracking.run_against(
                        line, bad, bench.reference, bench.ordinary_seconds, then, down
                    )
                )
        down.note = f"run at most {max(delays):.0f} s longer"
        yield down
        sent = tracking.bytes_sent(line, result, url)
        some = 2 if bench.quick else 12
        places = [round(sent * (i + 0.5) / some) for i in range(some)]
        for then, fault, these in (
            ("cut", "line to the tracking server cut in the middle of a sync", places),
            (
                "hang",
                "tracking server silent from the middle of a sync",
                places[:: max(1, some // 3)],
            ),
            (
                "kill",
                "tracking server killed in the middle of a sync",
                places[:: max(1, some // 4)],
            ),
        ):
            cut = Line("tracking", fault)
            bad_lines = [BadLine(after=after, then=then) for after in these]
            tracking.break_syncs(line, server, result, bad_lines, cut)
            yield cut
        slow = Line("tracking", "tracking server that answers late")
        delays_of = (0.5,) if bench.quick else (0.05, 0.5, 3.0)
        tracking.break_syncs(line, server, result, [BadLine(delay=d) for d in delays_of], slow)
        yield slow
    finally:
        server.stop()


PARTS: dict[str, Callable[[Bench], Iterable[Line]]] = {
    "points": points,
    "races": runs_at_once,
    "disk": full,
    "damage": damaged,
    "memory": out_of_memory,
    "kills": random_moments,
    "full-runs": full_for_runs,
    "prefect": prefect_server,
    "tracking": tracking_server,
}
"""Name -> what tries it."""
