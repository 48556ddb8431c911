"""How much memory a big scene takes: ``python benchmarks/big_scene.py``.

Prepares a scene of a million Gaussians with 300 views and answers queries in it, in a process of
its own that may not use more than the limit, and prints the seconds and the peak memory of every
stage. It fails where the limit is passed, or where the process runs into it.

The scene is that of ``render_speed.py``: a room with twelve spheres. The cameras stand on an
ellipse in the room, at several heights, and look across it. With ``--models random`` patches are
tiles of the picture and vectors are drawn by a generator, which costs next to nothing: that is for
looking at the stages themselves.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from render_scene import surface_scene

from datasets.base import GroundTruth, SceneData
from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.methods import MethodConfig, Toolbox
from gvr_core.models.base import Frame, Mask, Models
from gvr_core.models.random_encoder import RandomEncoder
from gvr_core.models.ranked_proposals import RankedProposals
from gvr_core.models.registry import build_models
from gvr_core.rendering import get_renderer
from gvr_core.robust.config import RobustConfig
from gvr_core.scene import Query, Scene, View
from reports.document import replace_block
from reports.environment import describe_environment
from tasks.scene_job import SceneJob
from tasks.stages import run_stages
from tasks.store import Store

BLOCK = "memory"
"""Name of the block of the page that ``--into`` rewrites."""
TEXTS = ("a ball", "a wall", "a cup of coffee", "the floor")
GOLDEN = 0.6180339887498949
"""Turns between cameras: any number of them is spread evenly."""


@dataclass(frozen=True)
class StageCost:
    """What one stage of one method cost."""

    method: str
    stage: str
    seconds: float
    cpu_seconds: float
    peak_bytes: int
    peak_of: str
    stored_bytes: int


class Tiles:
    """A segmenter that cuts every picture into six by four tiles, whatever it shows."""

    name = "tiles/1"

    def automatic(self, frame: Frame) -> list[Mask]:
        """The tiles, row by row."""
        height, width = frame.depth.shape
        rows, columns = np.arange(height) * 4 // height, np.arange(width) * 6 // width
        tile = rows[:, None] * 6 + columns[None]
        return [Mask(tile == number) for number in range(24)]

    def at_point(self, frame: Frame, point: tuple[float, float]) -> Mask:
        """The tile that holds the point; of a point beside the picture, the nearest."""
        height, width = frame.depth.shape
        x, y = np.clip(int(point[0]), 0, width - 1), np.clip(int(point[1]), 0, height - 1)
        return next(mask for mask in self.automatic(frame) if mask.pixels[y, x])

    def in_box(self, frame: Frame, box: tuple[float, float, float, float]) -> Mask:
        """The tile that holds the middle of the box."""
        return self.at_point(frame, ((box[0] + box[2]) / 2, (box[1] + box[3]) / 2))


def models_of(name: str) -> Models:
    if name == "onboard":
        return build_models()
    encoder = RandomEncoder(0)
    return Models(Tiles(), encoder, RankedProposals(Tiles(), encoder))


def room_views(n: int, width: int, height: int) -> tuple[View, ...]:
    """Cameras on an ellipse in the room, looking across it."""
    views = []
    for i in range(n):
        angle = 2 * np.pi * GOLDEN * i
        eye = np.array([2.2 * np.cos(angle), 1.3 * np.sin(angle), 0.3 + 0.6 * (i % 3) / 2])
        across = np.array([-0.5 * eye[0], -0.5 * eye[1], -0.4])
        camera = Camera(
            intrinsics(60, width, height), look_at(eye, across, [0, 0, 1]), width, height
        )
        views.append(View(f"view{i:04}", camera))
    return tuple(views)


def big_scene(n: int, views: int, width: int, height: int) -> SceneData:
    scene = Scene("big", f"{n}x{views}", surface_scene(n), room_views(views, width, height))
    queries = tuple(Query(id=f"q{i}", text=text) for i, text in enumerate(TEXTS))
    made_of = json.dumps([n, views, width, height]).encode()
    parts = ("gaussians", "views", "queries", "truth")
    digests = {part: hashlib.sha256(part.encode() + made_of).hexdigest() for part in parts}
    return SceneData(scene, queries, GroundTruth((), ()), digests, protocols=())


def costs(arguments: argparse.Namespace, folder: Path) -> Iterator[StageCost]:
    """Run the stages, method after method; what they share counts with the first."""
    data = big_scene(arguments.gaussians, arguments.views, *arguments.size)
    tools = Toolbox(get_renderer("numba"), models_of(arguments.models))
    for method in arguments.methods:
        # nothing in the scene has a name: what may refuse is made to answer, and so to segment
        config = MethodConfig(method=method, robust=RobustConfig(refusal=False))
        queries = data.queries[: arguments.queries]
        job = SceneJob(Store(folder), data, queries, config, tools, _say)
        for stage, run in run_stages(job, last="segment").items():
            if not run.cached:
                record = run.record
                measured = (record.seconds, record.cpu_seconds, record.peak_bytes, record.peak_of)
                yield StageCost(method, stage, *measured, record.total_bytes)


def _say(items: Iterable[Any], text: str) -> Iterator[Any]:
    """Every thirtieth item, on the error stream."""
    for i, item in enumerate(items):
        if i % 30 == 0:
            print(f"{text} {i}", file=sys.stderr, flush=True)
        yield item


def run_limited(arguments: argparse.Namespace, folder: Path) -> tuple[list[StageCost], int]:
    """The stages' costs, measured in a process with the limit, and how it ended."""
    command = [sys.executable, __file__, "--measure-in", str(folder)]
    command += ["--gaussians", str(arguments.gaussians), "--views", str(arguments.views)]
    command += ["--size", "x".join(map(str, arguments.size)), "--models", arguments.models]
    command += ["--queries", str(arguments.queries), "--limit-gb", str(arguments.limit_gb)]
    command += ["--methods", *arguments.methods]
    ended = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    return [StageCost(**json.loads(line)) for line in ended.stdout.splitlines()], ended.returncode


def limit_memory(most_gb: float) -> None:
    """Let this process ask for no more. Mapped files, which the system may drop, do not count."""
    most = int(most_gb * 1e9)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))


def table(found: Sequence[StageCost], views: int) -> str:
    lines = [
        "| method | stage | seconds | a view | processor s | peak MB | on disk, MB |",
        "| :--- | :--- | ---: | ---: | ---: | ---: | ---: |",
    ]
    for cost in found:
        each = f"{cost.seconds / views:.3f}" if cost.stage not in ("query", "segment") else "–"
        lines.append(
            f"| {cost.method} | {cost.stage} | {cost.seconds:.1f} | {each} |"
            f" {cost.cpu_seconds:.1f} | {cost.peak_bytes / 1e6:,.0f} |"
            f" {cost.stored_bytes / 1e6:,.1f} |"
        )
    return "\n".join(lines)


def _size(text: str) -> tuple[int, int]:
    width, height = text.split("x")
    return int(width), int(height)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--gaussians", type=int, default=1_000_000)
    parser.add_argument("--views", type=int, default=300)
    parser.add_argument("--size", type=_size, default=(988, 731), metavar="WIDTHxHEIGHT")
    parser.add_argument("--models", choices=("onboard", "random"), default="onboard")
    parser.add_argument("--methods", nargs="+", default=["gvr-paper", "gvr-robust"])
    parser.add_argument("--queries", type=int, default=2, help=f"at most {len(TEXTS)}")
    parser.add_argument("--limit-gb", type=float, default=8.0)
    parser.add_argument("--store", type=Path, help="keep what is computed here")
    parser.add_argument("--json", action="store_true", help="print one stage a line instead")
    parser.add_argument("--into", type=Path, help=f"rewrite the block '{BLOCK}' of this page")
    parser.add_argument("--measure-in", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure_in is not None:
        limit_memory(arguments.limit_gb)
        for cost in costs(arguments, arguments.measure_in):
            print(json.dumps(asdict(cost)), flush=True)
        return 0
    with tempfile.TemporaryDirectory() as temporary:
        found, status = run_limited(arguments, arguments.store or Path(temporary))
    if arguments.json:
        print("\n".join(json.dumps(asdict(cost)) for cost in found))
    peak = max((cost.peak_bytes for cost in found), default=0) / 1e9
    within = status == 0 and peak <= arguments.limit_gb
    width, height = arguments.size
    environment = describe_environment()
    text = (
        f"{arguments.gaussians:,} Gaussians, {arguments.views} views of {width}x{height},"
        f" {arguments.models} models, {arguments.queries} queries a method; {environment.processor}"
        f" ({environment.cpu_count} processors). Peak {peak:.2f} GB, limit"
        f" {arguments.limit_gb:g} GB: {'ok' if within else 'PASSED'}."
        f"\n\n{table(found, arguments.views)}"
    )
    if not arguments.json:
        print(text)
    if status != 0:
        print(f"the process that measured ended with status {status}", file=sys.stderr)
    if arguments.into is not None and within:
        replace_block(arguments.into, BLOCK, text)
    return 0 if within else 1


if __name__ == "__main__":
    raise SystemExit(main())
