"""What the workflow costs over a plain loop: ``python benchmarks/overhead.py``.

Runs the same work twice, in processes of their own and in turns: as a plain loop over gvr_core
(``plain_loop.py``), and as ``gvr run`` of a suite: command line, a cold Prefect server, the
artifact store, the result record with its pictures, and MLflow, everything in a fresh folder. Both
have to give the same metrics. Whole processes are timed, from start to exit; the scenes are made
before.

Bars: the flow takes at most a tenth and 15 s more than the loop, and MLflow at most 2 % of the run.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import typer
from measuring import Bar, Spread, markdown
from rich.console import Console

from datasets.gallery import GalleryDataset
from datasets.registry import data_root

ROOT = Path(__file__).resolve().parent.parent
SCENES = ("gallery_0", "gallery_1", "gallery_2", "gallery_3")
SHARE_BAR, SECONDS_BAR, MLFLOW_BAR = 0.10, 15.0, 0.02
RUN_SECONDS = 900
"""A run that takes longer has gone wrong."""


@dataclass(frozen=True)
class Work:
    """What both are to do."""

    scenes: tuple[str, ...] = SCENES
    method: str = "random-patch"
    """The control: retrieval and segmentation as ever, patches not encoded."""
    models: str = "onboard"
    limit: int = 1
    """Queries of each scene."""

    def suite(self) -> str:
        """The suite of the flow, as TOML."""
        return (
            f'name = "overhead"\nlimit = {self.limit}\n'
            f'[[datasets]]\nname = "gallery"\nscenes = {json.dumps(self.scenes)}\n'
            f'[[methods]]\nmethod = "{self.method}"\n'
        )


QUICK = Work(scenes=("gallery_0",), models="oracle", limit=2)


@dataclass(frozen=True)
class FlowRun:
    """One run of the flow."""

    wall: float
    """Seconds of the whole process."""
    cpu: float
    """Processor seconds of it and of all that it started and waited for."""
    parts: dict[str, float]
    """Part of the process -> seconds, see :mod:`overhead_child`."""
    stages: dict[str, float]
    """Stage -> seconds, all scenes together."""


@dataclass(frozen=True)
class Overhead:
    """All repeats."""

    work: Work
    loops: tuple[float, ...]
    """Seconds of each run of the loop, whole process."""
    loop_cpus: tuple[float, ...]
    """Processor seconds of each."""
    flows: tuple[FlowRun, ...]
    n_metrics: int = 0
    """Numbers that both gave, and in which they agree."""
    bars: tuple[Bar, ...] = field(init=False)

    def __post_init__(self) -> None:
        loop, flow = self.loop.median, self.flow.median
        share = Spread.of([run.parts["MLflow"] / run.wall for run in self.flows]).median
        limit = (1 + SHARE_BAR) * loop + SECONDS_BAR
        bars = (
            Bar(f"flow, where the loop takes {loop:.1f} s (10 % and 15 s more)", flow, limit, "s"),
            Bar("MLflow, part of the run", 100 * share, 100 * MLFLOW_BAR, "%"),
        )
        object.__setattr__(self, "bars", bars)

    @property
    def loop(self) -> Spread:
        """Seconds of the loop."""
        return Spread.of(self.loops)

    @property
    def flow(self) -> Spread:
        """Seconds of the flow."""
        return Spread.of([run.wall for run in self.flows])

    def part(self, name: str) -> Spread:
        """Seconds of a part of the flow."""
        return Spread.of([run.parts[name] for run in self.flows])

    def stage(self, name: str) -> Spread:
        """Seconds of a stage."""
        return Spread.of([run.stages[name] for run in self.flows])


def measure(work: Work, repeats: int, say: Callable[[str], object] = str) -> Overhead:
    """Run loop and flow in turns.

    Args:
        work: What they do.
        repeats: Of each.
        say: Told what is being done.

    Raises:
        RuntimeError: if a run fails, or the two disagree in a metric.
    """
    dataset = GalleryDataset(data_root() / "gallery")
    for scene in work.scenes:
        dataset.load(scene)
    loops: list[Child] = []
    flows: list[FlowRun] = []
    compared = 0
    for repeat in range(repeats):
        with tempfile.TemporaryDirectory() as folder:
            say(f"{repeat + 1} of {repeats}: loop")
            loops.append(run_child("loop", work, Path(folder)))
            say(f"{repeat + 1} of {repeats}: flow")
            flow = run_child("flow", work, Path(folder))
        told = flow.told
        compared = check_equal(loops[-1].told, told["scores"])
        parts = told["parts"] | {"start and exit": flow.wall - told["wall"]}
        flows.append(FlowRun(flow.wall, flow.cpu, parts, told["stages"]))
    walls, cpus = ([getattr(loop, name) for loop in loops] for name in ("wall", "cpu"))
    return Overhead(work, tuple(walls), tuple(cpus), tuple(flows), compared)


@dataclass(frozen=True)
class Child:
    """A process that has ended."""

    wall: float
    cpu: float
    told: dict[str, Any]
    """What it wrote."""


def run_child(kind: str, work: Work, folder: Path) -> Child:
    """Run loop or flow as a process of its own.

    Raises:
        RuntimeError: if it fails.
    """
    home = folder / "home"
    suite, out = folder / "suite.toml", folder / f"{kind}.json"
    suite.write_text(work.suite(), encoding="utf-8")
    own = ("GVR_STORE", "GVR_RESULTS", "MLFLOW_TRACKING_URI", "PREFECT_API_URL")
    environment = {name: value for name, value in os.environ.items() if name not in own}
    environment |= {
        "GVR_HOME": str(home),
        "GVR_DATA": str(data_root().resolve()),
        "PYTHONPATH": str(ROOT),
    }
    command = [
        sys.executable, str(ROOT / "benchmarks" / "overhead_child.py"),
        kind, str(suite), str(out), work.models,
    ]  # fmt: skip
    start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=RUN_SECONDS
    )
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode or not out.exists():
        raise RuntimeError(f"the {kind} ended with {done.returncode}:\n{done.stderr[-3000:]}")
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Child(wall, cpu, json.loads(out.read_text(encoding="utf-8")))


def check_equal(loop: dict[str, dict], flow: dict[str, dict]) -> int:
    """How many metrics both gave.

    Raises:
        RuntimeError: if they differ in one, so that they did not do the same work.
    """
    if loop != flow:
        places = [place for place in {**loop, **flow} if loop.get(place) != flow.get(place)]
        first = places[0]
        raise RuntimeError(
            f"loop and flow differ in {len(places)} places; {first}: "
            f"{loop.get(first)} and {flow.get(first)}"
        )
    return sum(len(metrics) for metrics in loop.values())


def tables(found: Overhead) -> str:
    """The figures as Markdown."""
    work, repeats = found.work, len(found.loops)
    rows = [
        ("plain loop", found.loop.shown(), Spread.of(found.loop_cpus).shown()),
        ("flow", found.flow.shown(), Spread.of([run.cpu for run in found.flows]).shown()),
        *((f"- {name}", found.part(name).shown(digits=2), "") for name in found.flows[0].parts),
    ]
    return "\n\n".join(
        [
            f"{len(work.scenes)} scenes of the gallery, {work.method}, {work.models} models, "
            f"{work.limit} queries a scene; seconds of whole processes, median (least-most) of "
            f"{repeats}, in turns, each flow in a fresh folder with a cold Prefect server. Loop "
            f"and flow agree in all {found.n_metrics} metrics.",
            markdown(("process", "seconds", "of a processor"), rows),
            markdown(("bar", "measured", "limit", ""), [bar.cells() for bar in found.bars]),
        ]
    )


def main(
    repeats: Annotated[int, typer.Option(min=1)] = 3,
    quick: Annotated[bool, typer.Option("--quick", help="One scene, once.")] = False,
) -> None:
    """Measure and print."""
    console = Console(soft_wrap=True, highlight=False)
    errors = Console(stderr=True)
    found = measure(QUICK if quick else Work(), 1 if quick else repeats, errors.print)
    console.print(tables(found), markup=False)


if __name__ == "__main__":
    typer.run(main)
