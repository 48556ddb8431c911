"""How the time of a render grows, and what pictures and masks save by being asked for together."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from render_scene import corner_camera, seconds_of, surface_scene
from rich.table import Table

from gvr_core.cameras import Camera
from gvr_core.gaussians import Gaussians
from gvr_core.rendering.base import mask_by_mask, one_by_one
from gvr_core.rendering.numba_renderer import NumbaRenderer


@dataclass(frozen=True)
class Growth:
    """How the time of a render grows with one of the things it depends on."""

    over: str
    """``"Gaussians"`` or ``"pixels"``; the other one is held."""
    held: str
    constant_ms: float
    slope_ns: float
    """Nanoseconds for each one more."""
    explained: float
    """R^2 of a straight line."""
    furthest: float
    """Largest distance of a measurement from the line, as a part of the measurement."""
    points: tuple[tuple[int, float], ...]
    """Count, milliseconds."""


def growth(over: str, held: str, points: Sequence[tuple[int, float]]) -> Growth:
    """A straight line through (count, seconds).

    Args:
        over: What is counted.
        held: What is not.
        points: Counts and seconds.
    """
    counts, seconds = (np.array(column, np.float64) for column in zip(*points, strict=True))
    slope, constant = np.polyfit(counts, seconds, 1)
    rest = seconds - (constant + slope * counts)
    explained = 1 - float(rest @ rest / ((seconds - seconds.mean()) ** 2).sum())
    furthest = float((np.abs(rest) / seconds).max())
    listed = tuple((int(n), 1e3 * float(s)) for n, s in zip(counts, seconds, strict=True))
    return Growth(over, held, 1e3 * constant, 1e9 * slope, explained, furthest, listed)


def measure_growth(repeats: int = 5) -> list[Growth]:
    """Processor time on one thread over Gaussians at 640 x 480, and over pixels at 200,000.

    Args:
        repeats: Renders of which the least time counts.
    """
    single = NumbaRenderer(1)

    def least(gaussians: Gaussians, camera: Camera) -> float:
        single.render(gaussians, camera)
        work = partial(single.render, gaussians, camera)
        return min(seconds_of(work, time.thread_time) for _ in range(repeats))

    counts = (50_000, 100_000, 200_000, 400_000, 700_000, 1_000_000)
    over_n = [(n, least(surface_scene(n), corner_camera(640, 480))) for n in counts]
    scene = surface_scene(200_000)
    sizes = ((320, 240), (480, 360), (640, 480), (800, 600), (988, 731), (1280, 960))
    over_pixels = [(w * h, least(scene, corner_camera(w, h))) for w, h in sizes]
    return [
        growth("Gaussians", "640x480", over_n),
        growth("pixels", "200,000 Gaussians", over_pixels),
    ]


def growth_table(found: Sequence[Growth]) -> Table:
    table = Table("over", "at", title="Growth of a render, one core, processor time")
    for name in ("constant, ms", "ns each", "R^2", "furthest off"):
        table.add_column(name, justify="right")
    for one in found:
        table.add_row(
            *(one.over, one.held, f"{one.constant_ms:.1f}", f"{one.slope_ns:.1f}"),
            *(f"{one.explained:.4f}", f"{one.furthest:.0%}"),
        )
    table.caption = "a straight line, and how far the measurement furthest from it is off"
    return table


@dataclass(frozen=True)
class SharedWork:
    """What several pictures, or several masks, cost together and one by one, milliseconds each."""

    what: str
    together: float
    one_by_one: float
    together_processor: float
    one_by_one_processor: float


def measure_sharing(views: int = 8, masks: int = 64, repeats: int = 3) -> list[SharedWork]:
    """Pictures of several cameras, and weights under several masks of one.

    Args:
        views: How many cameras.
        masks: How many masks.
        repeats: Runs of which the least time counts.
    """
    gaussians, renderer = surface_scene(200_000), NumbaRenderer()
    cameras = [corner_camera(640, 480)] * views
    rng = np.random.default_rng(0)
    boxes = np.zeros((masks, 480, 640), np.bool_)
    for box in boxes:
        x, y = rng.integers(0, 500), rng.integers(0, 360)
        box[y : y + 100, x : x + 120] = True

    def compared(
        what: str, n: int, many: Callable[[], object], one: Callable[[], object]
    ) -> SharedWork:
        times = []
        for work in (many, one):
            work()
            for clock in (time.perf_counter, time.process_time):
                times.append(1e3 / n * min(seconds_of(work, clock) for _ in range(repeats)))
        return SharedWork(what, times[0], times[2], times[1], times[3])

    return [
        compared(
            f"{views} pictures",
            views,
            lambda: list(renderer.render_many(gaussians, cameras)),
            lambda: list(one_by_one(renderer, gaussians, cameras)),
        ),
        compared(
            f"weights under {masks} masks",
            masks,
            lambda: renderer.weights(gaussians, cameras[0], boxes),
            lambda: mask_by_mask(renderer, gaussians, cameras[0], boxes),
        ),
    ]


def sharing_table(found: Sequence[SharedWork]) -> Table:
    table = Table("what", title="200,000 Gaussians, 640x480: milliseconds each")
    for name in ("together", "one by one", "processor", "processor, one by one"):
        table.add_column(name, justify="right")
    for one in found:
        figures = (one.together, one.one_by_one, one.together_processor, one.one_by_one_processor)
        table.add_row(one.what, *(f"{figure:.2f}" for figure in figures))
    return table
