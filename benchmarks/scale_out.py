"""What a scene costs beside its own computing: ``python benchmarks/scale_out.py``.

Makes small scenes, runs them with each runner on a store of its own, and prints whether all gave
the same record, and how long they took. The Prefect server is started before, and not counted.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.making import take_pictures
from datasets.native_writer import write_scene
from flows.benchmark import BenchmarkOutcome, run_benchmark
from flows.run_config import RunConfig
from flows.suite import DatasetChoice, SuiteConfig
from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.gaussians import SH_C0, Gaussians
from gvr_core.models.registry import ModelConfig
from gvr_core.rendering import get_renderer
from gvr_core.scene import Query
from reports.document import replace_block
from reports.environment import describe_environment
from reports.same_record import differences
from tasks.prefect_runtime import prefect_runtime
from tasks.store import Store

OBJECTS = ("red box", "blue box")
UP = np.array([0.0, 0.0, 1.0])
RUNNERS = ("serial", "threads", "processes", "dask")
BLOCK = "scale_out"


@dataclass(frozen=True)
class Measured:
    """One runner's run on an empty store, and its run again on the full one."""

    runner: str
    workers: int
    same: str
    """``yes``, or what differs from the serial record."""
    call: float
    """Seconds of the whole call, with the start and end of workers."""
    flow: float
    """Seconds of the flow."""
    stages: float
    """Seconds of all stages."""
    again: float
    """Seconds of the flow where all is cached."""


def make_scenes(folder: Path, count: int) -> Path:
    """Write so many small scenes in the native layout; no two are alike."""
    for number in range(count):
        _make_scene(folder / f"scene_{number:04d}", number)
    return folder


def _make_scene(folder: Path, number: int) -> None:
    random = np.random.default_rng(number)
    ticks = np.linspace(-2.5, 2.5, 30)
    plane = np.stack(np.meshgrid(ticks, ticks, [0.0]), axis=-1).reshape(-1, 3)
    boxes = []
    for side, x in ((0.8, -1.0), (0.6, 1.0)):
        steps = np.linspace(-side / 2, side / 2, 9)
        grid = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
        boxes.append(grid + np.array([x, random.uniform(-0.7, 0.7), side / 2 + 0.05]))
    parts = [
        _round_gaussians(boxes[0], (0.9, 0.1, 0.1), 0.07),
        _round_gaussians(boxes[1], (0.1, 0.1, 0.9), 0.06),
        _round_gaussians(plane, (0.5, 0.5, 0.5), 0.11),
    ]
    kinds = ((parts[0], 0), (parts[1], 1), (parts[2], -1))
    labels = np.concatenate([np.full(len(part), label) for part, label in kinds]).astype(np.int16)
    gaussians = Gaussians.concatenate(parts)
    matrix = intrinsics(60, 64, 48)
    cameras = {}
    for i, yaw in enumerate(2 * np.pi * np.arange(6) / 6):
        eye = np.array([4 * np.cos(yaw), 4 * np.sin(yaw), 2.0])
        cameras[f"v{i}"] = Camera(matrix, look_at(eye, (0, 0, 0.3), UP), 64, 48)
    write_scene(
        folder,
        dataset="scale",
        name=folder.name,
        gaussians=gaussians,
        pictures=take_pictures(
            get_renderer("numba"), gaussians, labels, OBJECTS, cameras, ("v1", "v4")
        ),
        objects=OBJECTS,
        labels=labels,
        queries=(
            Query(id="red-1", text="a red box", target=OBJECTS[0]),
            Query(id="blue-1", text="a blue box", target=OBJECTS[1]),
        ),
        up=UP,
        provenance="made by benchmarks/scale_out.py",
    )


def _round_gaussians(means: np.ndarray, rgb: tuple[float, ...], sigma: float) -> Gaussians:
    n = len(means)
    quats = np.zeros((n, 4), np.float32)
    quats[:, 0] = 1
    sh = np.tile(((np.array(rgb) - 0.5) / SH_C0).astype(np.float32), (n, 1, 1))
    scales = np.full((n, 3), sigma, np.float32)
    return Gaussians(means.astype(np.float32), scales, quats, np.full(n, 0.95, np.float32), sh)


def scale_suite(scenes: Path, run: RunConfig) -> SuiteConfig:
    """The paper's method on all scenes, with models that know the truth."""
    return SuiteConfig(
        name="scale",
        datasets=(DatasetChoice(name=f"folder:{scenes}"),),
        models=ModelConfig(segmenter="oracle", encoder="oracle", text_segmenter="oracle"),
        run=run,
    )


def measure(scenes: Path, folder: Path, runner: str, workers: int, serial: Path | None) -> Measured:
    """Run the scenes twice with one runner, on an empty and then on the full store."""
    run = RunConfig(runner=runner, workers=None if runner == "serial" else workers)
    suite = scale_suite(scenes, run)
    store, results = folder / runner / "store", folder / runner / "results"
    start = time.perf_counter()
    first = run_benchmark(suite, str(store), str(results))
    call = time.perf_counter() - start
    again = run_benchmark(suite, str(store), str(results))
    differing = differences(serial or first.folder, first.folder)
    differing += differences(first.folder, again.folder) + first.failed + again.failed
    return Measured(
        runner,
        1 if runner == "serial" else workers,
        "yes" if not differing else f"no: {', '.join(differing[:3])}",
        call,
        first.result.wall_seconds,
        _stage_seconds(first),
        again.result.wall_seconds,
    )


def _stage_seconds(outcome: BenchmarkOutcome) -> float:
    return sum(stage.seconds for scene in outcome.result.scenes for stage in scene.stages)


def table(measured: list[Measured], scenes: int) -> str:
    """The figures in Markdown."""
    seen = describe_environment()
    lines = [
        f"{scenes} small scenes, one method of eight stages; {seen.cpu_count} x {seen.processor}.",
        "",
        "| runner | workers | same record | whole call | flow | stages | beside stages, a scene "
        "| all cached, a scene |",
        "| :--- | ---: | :--- | ---: | ---: | ---: | ---: | ---: |",
    ]
    for each in measured:
        beside = (each.flow * each.workers - each.stages) / scenes
        cached = each.again * each.workers / scenes
        lines.append(
            f"| {each.runner} | {each.workers} | {each.same} | {each.call:.1f} s | "
            f"{each.flow:.1f} s | {each.stages:.1f} s | {beside:.2f} s | {cached:.2f} s |"
        )
    lines += [
        "",
        "Flow: from the first scene handed out to the last one in, without the start of the "
        "Prefect server. Beside stages: flow times workers less the seconds of all stages, for "
        "each scene; the start of worker processes is in it. All cached: a second run, in which "
        "no stage computes.",
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure, print, and put the table into a document where one is named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--runner", action="append", choices=RUNNERS)
    parser.add_argument("--into", type=Path, help=f"document with <!-- {BLOCK} --> lines")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scenes = make_scenes(folder / "scenes", given.scenes)
        measured: list[Measured] = []
        serial: Path | None = None
        with prefect_runtime(Store(folder / "store")):
            for runner in given.runner or RUNNERS:
                measured.append(measure(scenes, folder, runner, given.workers, serial))
                (first, _) = sorted((folder / runner / "results").iterdir())
                serial = serial or first
                print(measured[-1], flush=True)
    text = table(measured, given.scenes)
    print(text)
    if given.into is not None:
        replace_block(given.into, BLOCK, text)


if __name__ == "__main__":
    main()
