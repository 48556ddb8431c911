"""All speed benchmarks in one go: ``make perf``, or ``python benchmarks/perf.py [--quick]``.

Measures the renderer, the methods, their growth with Gaussians, views and queries, the workflow
against a plain loop, and where the time goes, one after the other in one tree of processes, and
writes docs/performance.md: its tables, its picture, and how it stands against the bars. On a quiet
machine it takes about a quarter of an hour; ``--quick`` takes a minute and a half, measures less
of everything, and prints without writing unless ``--into`` names a page.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import growth
import overhead
import query_speed
import torch
import typer
from hot_spots import HotSpot, profile
from perf_plots import growth_picture
from perf_sections import SECTIONS, sections
from render_scene import corner_camera, surface_scene
from render_speed import SIZES, RenderTimes, TwinTimes, render_times, twin_times
from rich.console import Console

from datasets.gallery import GalleryDataset
from datasets.registry import data_root
from gvr_core.atomic import atomic_write
from gvr_core.methods import MethodConfig, Toolbox, build_method
from gvr_core.models.registry import ModelConfig, build_models
from gvr_core.rendering.numba_renderer import NumbaRenderer
from gvr_core.rendering.torch_reference import TorchReference
from reports.document import read_block, replace_block

PAGE = Path(__file__).resolve().parent.parent / "docs" / "performance.md"
PICTURE = "performance.png"


@dataclass(frozen=True)
class Plan:
    """How much is measured."""

    counts: tuple[int, ...] = (50_000, 100_000, 200_000, 500_000, 1_000_000)
    """Gaussians of the renderer's scenes."""
    sizes: tuple[tuple[int, int], ...] = SIZES
    renders: int = 9
    """Pictures of each kind."""
    twin_threads: tuple[int, ...] | None = None
    """Of the torch twin, which takes the best; None for one, and torch's own choice."""
    gaussians: int = 100_000
    """Of the scene that methods are compared on."""
    views: int = 30
    repeats: int = 3
    """Of each preparation, and of all queries together."""
    queries: int = 24
    grown_gaussians: tuple[int, ...] = (50_000, 100_000, 200_000, 500_000, 1_000_000)
    grown_views: tuple[int, ...] = (10, 30, 100, 300)
    grown_queries: tuple[int, ...] = (1, 5, 20, 100, 500)
    query_repeats: int = 3
    asked: query_speed.Size = field(default_factory=query_speed.Size)
    """The scene on which queries are timed step by step."""
    work: overhead.Work = field(default_factory=overhead.Work)
    profiled: int = 3
    """Queries of the profile on a scene with the onboard models; 0 profiles the room instead."""
    quick: bool = False


QUICK = Plan(
    counts=(50_000, 200_000),
    sizes=((640, 480),),
    renders=3,
    twin_threads=(1,),
    gaussians=20_000,
    views=6,
    repeats=3,
    queries=6,
    grown_gaussians=(10_000, 20_000, 50_000),
    grown_views=(3, 6, 12),
    grown_queries=(1, 5, 20),
    query_repeats=1,
    asked=query_speed.Size(gaussians=20_000, views=20, patches=20, queries=5),
    work=overhead.QUICK,
    profiled=0,
    quick=True,
)


@dataclass(frozen=True)
class Measured:
    """Everything that a run found."""

    plan: Plan
    renders: list[RenderTimes]
    twins: TwinTimes
    methods: list[growth.MethodTimes]
    grown: list[growth.Growth]
    asked: list[query_speed.QuerySpeed]
    overhead: overhead.Overhead
    profiled: str
    """What was profiled."""
    profile_seconds: float
    hot: list[HotSpot]
    seconds: float
    """Of the whole run."""


def measure(plan: Plan, say: Console) -> Measured:
    """Run all benchmarks, one after the other.

    Args:
        plan: How much.
        say: Told what is being done.
    """
    start = time.perf_counter()

    def step(text: str) -> None:
        say.print(f"{time.perf_counter() - start:5.0f} s  {text}", markup=False, highlight=False)

    step("compiling, or loading compiled code")
    growth.method_times(2000, 3, 1, 1)
    NumbaRenderer().render(surface_scene(100), corner_camera(64, 48))
    renders = []
    for count in plan.counts:
        step(f"renderer, {count:,} Gaussians")
        scene = surface_scene(count)
        renders += [render_times(scene, size, plan.renders) for size in plan.sizes]
    step("renderer and its torch twin")
    references = [TorchReference(torch.float32)]
    twins = twin_times(NumbaRenderer(), plan.renders, references, plan.twin_threads)
    step(f"methods, {plan.gaussians:,} Gaussians, {plan.views} views")
    methods = growth.method_times(plan.gaussians, plan.views, plan.queries, plan.repeats)
    step(f"growth with Gaussians, to {max(plan.grown_gaussians):,}")
    few = min(plan.views, 10)
    grown = growth.with_gaussians("gvr-paper", plan.grown_gaussians, few, plan.repeats)
    step(f"growth with views, to {max(plan.grown_views)}")
    grown += growth.with_views("gvr-paper", plan.grown_views, plan.gaussians // 2, plan.repeats)
    step(f"growth with queries, to {max(plan.grown_queries)}")
    room = (plan.gaussians // 2, few, plan.query_repeats)
    grown.append(growth.with_queries("gvr-paper", plan.grown_queries, *room))
    step(f"queries step by step, {plan.asked.gaussians:,} Gaussians, {plan.asked.views} views")
    asked = query_speed.speeds(plan.asked, query_speed.METHODS)
    step("flow and plain loop")
    found = overhead.measure(plan.work, 1 if plan.quick else 3, step)
    step("profile")
    what, work = _work_to_profile(plan)
    seconds, hot = profile(work)
    step("done")
    return Measured(
        plan=plan,
        renders=renders,
        twins=twins,
        methods=methods,
        grown=grown,
        asked=asked,
        overhead=found,
        profiled=what,
        profile_seconds=seconds,
        hot=hot,
        seconds=time.perf_counter() - start,
    )


def _work_to_profile(plan: Plan):
    if not plan.profiled:
        what = f"gvr-paper in the room, {plan.views} views, {plan.queries} queries, oracle models"
        return what, growth.profiled("gvr-paper", plan.gaussians, plan.views, plan.queries)
    data = GalleryDataset(data_root() / "gallery").load("gallery_0")
    tools = Toolbox(NumbaRenderer(), build_models(ModelConfig()))
    method = build_method(MethodConfig(), tools)

    def work() -> None:
        books = method.prepare(data.scene)
        for query in data.queries[: plan.profiled]:
            method.ground(data.scene, books, query)

    return f"gvr-paper on gallery_0, {plan.profiled} queries, onboard models", work


def check_page(page: Path) -> None:
    """Refuse a page that a run could not be written into.

    Raises:
        ResultError: for a page that cannot be read or lacks one of the blocks.
    """
    for name in SECTIONS:
        read_block(page, name)


def write(found: Measured, page: Path) -> None:
    """Put the tables into the page and the picture beside it.

    Raises:
        ResultError: for a page that cannot be written, or lacks one of the blocks.
    """
    for name, text in sections(found).items():
        replace_block(page, name, text)
    picture = page.parent / "pictures" / PICTURE
    picture.parent.mkdir(exist_ok=True)
    with atomic_write(picture) as stream:
        stream.write(growth_picture(found.grown, found.renders))


def main(
    quick: Annotated[bool, typer.Option("--quick", help="A minute and a half.")] = False,
    into: Annotated[
        Path | None, typer.Option(help="The page; docs/performance.md, and none with --quick.")
    ] = None,
) -> None:
    """Measure, print, and write the page."""
    page = into or (None if quick else PAGE)
    if page is not None:
        check_page(page)  # before a quarter of an hour is spent
    found = measure(QUICK if quick else Plan(), Console(stderr=True))
    console = Console(soft_wrap=True, highlight=False)
    for name, text in sections(found).items():
        console.print(f"\n{name}\n\n{text}", markup=False)
    if page is not None:
        write(found, page)


if __name__ == "__main__":
    typer.run(main)
