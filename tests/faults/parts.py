"""The parts of ``benchmarks/reliability.py``: each tries one kind of fault."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from faults import damage, full_disk, kills, races
from faults.lines import Line
from faults.work import Work, comparable, emptied


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
        step = max(1, len(chosen) // 3) if bench.quick else 1
        kills.kill_at_points(
            bench.work, bench.folder, bench.reference, names, chosen[::step], line
        )
        yield line


def runs_at_once(bench: Bench) -> Iterable[Line]:
    """Several runs on one store."""
    for runs, kill_in, fault in (
        (2, None, "two runs at once: each artifact computed once"),
        (4, None, "four runs at once: each artifact computed once"),
        (4, "masks", "four runs at once, the one that computes killed"),
    ):
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
            sizes = full_disk.sizes_up_to(needed, 3 if bench.quick else 16)
            options = [f"size={size}" for size in sizes]
            files = len(list((bench.undisturbed / name).rglob("*")))
            some = 1 if bench.quick else 5
            options += [f"size=64m,nr_inodes={files * (i + 1) // (some + 1)}" for i in range(some)]
            full_disk.fill_disk(bench.work, bench.folder, bench.reference, name, options, line)
        else:
            line.skipped = "mounting needs root: unshare -rm python benchmarks/reliability.py"
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


PARTS: dict[str, Callable[[Bench], Iterable[Line]]] = {
    "points": points,
    "races": runs_at_once,
    "disk": full,
    "damage": damaged,
}
"""Name -> what tries it."""
