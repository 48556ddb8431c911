"""How fast the CPU renderer is: ``python benchmarks/render_speed.py``.

Prints the time of each stage (minima over repeats), the ratio to the torch reference, and the
ratio of blending to what its arithmetic alone would take on the same machine in the same minute.

The scenes are surfaces, as captures are: half of the Gaussians lie on the six sides of a room of
6 x 4 x 3, half on twelve spheres in it, flat along the surface (a tenth as thick as wide), 0.6 of
their mean spacing wide with a log-normal spread of 0.5, opacities sigmoid(normal(1.5, 2)),
spherical harmonics of degree 3. The camera stands in a corner of the room and sees about 54 % of
them. More Gaussians are smaller ones, so that the picture stays the same.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.gaussians import Gaussians
from gvr_core.rendering.base import mask_by_mask, one_by_one
from gvr_core.rendering.blending import STATE, blend_row
from gvr_core.rendering.layout import MEAN_X, MEAN_Y, T0, T_MIN, TILE, A, B, C
from gvr_core.rendering.numba_renderer import Binned, NumbaRenderer, StageSeconds
from gvr_core.rendering.torch_reference import TorchReference

SIZES = ((640, 480), (988, 731))
TORCH_BAR, BLEND_BAR = 20.0, 7.0


def surface_scene(n: int, seed: int = 0) -> Gaussians:
    """The scene of the module's description.

    Args:
        n: Number of Gaussians.
        seed: Of the random numbers.
    """
    rng = np.random.default_rng(seed)
    room, on_walls = np.array([6.0, 4.0, 3.0]), n // 2
    centres, radii = (rng.random((12, 3)) - 0.5) * room * 0.7, rng.uniform(0.2, 0.5, 12)
    side = rng.integers(0, 6, on_walls)
    walls = (rng.random((on_walls, 3)) - 0.5) * room
    rows = np.arange(on_walls)
    walls[rows, side % 3] = np.where(side < 3, -0.5, 0.5) * room[side % 3]
    wall_normals = np.zeros((on_walls, 3))
    wall_normals[rows, side % 3] = 1
    ball = rng.integers(0, 12, n - on_walls)
    outward = rng.normal(size=(n - on_walls, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    means = np.concatenate([walls, centres[ball] + radii[ball, None] * outward])
    normals = np.concatenate([wall_normals, outward])

    area = 2 * (6 * 4 + 6 * 3 + 4 * 3) + 4 * np.pi * (radii**2).sum()
    scales = 0.6 * np.sqrt(area / n) * np.exp(rng.normal(0, 0.5, (n, 3)))
    scales[:, 2] *= 0.1
    quats = np.column_stack([1 + normals[:, 2], np.cross([0, 0, 1], normals)])
    quats[np.linalg.norm(quats, axis=1) < 1e-6] = (0, 1, 0, 0)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    sh = rng.normal(0, 0.1, (n, 16, 3))
    sh[:, 0] = rng.normal(0, 1, (n, 3))
    opacities = 1 / (1 + np.exp(-rng.normal(1.5, 2, n)))
    arrays = (np.asarray(a, np.float32) for a in (means, scales, quats, opacities, sh))
    return Gaussians(*arrays)


def corner_camera(width: int, height: int) -> Camera:
    pose = look_at([2.5, 1.2, 0.3], [-1, -0.5, -0.2], [0, 0, 1])
    return Camera(intrinsics(60, width, height), pose, width, height)


def seconds_of(work: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    start = clock()
    work()
    return clock() - start


@njit(nogil=True, error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def _blend_rows(times: int, state: NDArray[np.float32], values: NDArray[np.float32]) -> None:
    """The blending's arithmetic and nothing else: all rows of one tile, again and again."""
    for n in range(times):
        a = values[n & 63]
        for y in range(TILE):
            shift = np.float32(y)
            blend_row(state[y], a * shift, a, a * a - shift, a, a, a, a, None, None)


def pairs_a_second() -> float:
    """(Gaussian, pixel) pairs that the blending's arithmetic does in a second of one core."""
    times, line = 20_000, 16
    values = np.linspace(0.01, 0.3, 64, dtype=np.float32)
    room = np.zeros(TILE * STATE + line, np.float32)
    skip = (-room.ctypes.data // 4) % line  # as the renderer aligns its own
    state = room[skip : skip + TILE * STATE].reshape(TILE, STATE)
    _blend_rows(1, state, values)
    work = lambda: _blend_rows(times, state, values)  # noqa: E731
    return times * TILE * TILE / min(seconds_of(work, time.thread_time) for _ in range(10))


@njit(nogil=True, error_model="numpy")
def _pairs_drawn(
    first_pair: NDArray[np.int64],
    pairs: NDArray[np.int32],
    rows: NDArray[np.float32],
    tiles_x: int,
    width: int,
    height: int,
) -> int:
    drawn = 0
    for tile in range(first_pair.shape[0] - 1):
        left, top = tile % tiles_x * TILE, tile // tiles_x * TILE
        for y in range(top, min(top + TILE, height)):
            for x in range(left, min(left + TILE, width)):
                through = 1.0
                for pair in range(first_pair[tile], first_pair[tile + 1]):
                    row = rows[pairs[pair]]
                    dx, dy = x + 0.5 - row[MEAN_X], y + 0.5 - row[MEAN_Y]
                    t = row[T0] - (row[A] * dx - row[B] * dy) ** 2 - (row[C] * dy) ** 2
                    if t >= T_MIN:
                        drawn += 1
                        through *= 1 - min(2 ** (8 * t), 0.999)
                        if through <= 1e-4:
                            break
    return drawn


def pairs_drawn(binned: Binned, camera: Camera) -> int:
    """Pairs with an alpha of 1/255 or more, up to the stop: the least that must be blended."""
    return int(
        _pairs_drawn(
            binned.first_pair,
            binned.pairs,
            binned.rows,
            binned.tiles[0],
            camera.width,
            camera.height,
        )
    )


def stage_minima(timings: list[StageSeconds]) -> StageSeconds:
    """The least time of each stage over some renders, seconds."""
    names = ("project", "sort", "bin", "blend")
    return StageSeconds(*(min(getattr(timing, name) for timing in timings) for name in names))


def linear_fit(points: list[tuple[int, int, float]]) -> tuple[NDArray[np.float64], float]:
    """Least squares of seconds = a + b pixels + c Gaussians, and the share explained (R^2)."""
    pixels, counts, seconds = (np.array(column, np.float64) for column in zip(*points, strict=True))
    design = np.column_stack([np.ones_like(pixels), pixels, counts])
    solution = np.linalg.lstsq(design, seconds, rcond=None)[0]
    rest = seconds - design @ solution
    return solution, 1 - float(rest @ rest / ((seconds - seconds.mean()) ** 2).sum())


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


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--counts", type=int, nargs="+", default=[50_000, 200_000, 1_000_000])
    parser.add_argument("--repeats", type=int, default=12)
    parser.add_argument("--threads", type=int, default=None)
    parser.add_argument("--without-torch", action="store_true")
    arguments = parser.parse_args()
    renderer, single = NumbaRenderer(arguments.threads), NumbaRenderer(1)
    console = Console(width=100)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    first = seconds_of(lambda: renderer.render(surface_scene(100), corner_camera(64, 48)))
    console.print(
        f"{renderer.name}, {renderer.threads} threads, load {load:.1f}; first render {first:.1f} s "
        f"(compiling, or loading compiled code); minima of {arguments.repeats}, milliseconds"
    )

    stages = Table("Gaussians", "picture", "seen", title="Time by stage")
    for name in ("project", "sort", "bin", "blend", "total", "with a mask"):
        stages.add_column(name, justify="right")
    limits = Table("Gaussians", "picture", title="Blending against its arithmetic, one core")
    for name in ("pairs drawn", "Gpairs/s", "least", "blend", "ratio"):
        limits.add_column(name, justify="right")
    points = []
    for count in arguments.counts:
        gaussians = surface_scene(count)
        for width, height in SIZES:
            camera, mask = corner_camera(width, height), np.ones((height, width), np.float32)
            runs, label = range(arguments.repeats), (f"{count:,}", f"{width}x{height}")
            plain = [renderer.render_timed(gaussians, camera)[1] for _ in runs]
            masked = [renderer.render_timed(gaussians, camera, mask=mask)[1] for _ in runs]
            best, total = stage_minima(plain), min(timing.total for timing in plain)
            times = (best.project, best.sort, best.bin, best.blend, total)
            times = (*times, min(timing.total for timing in masked))
            binned = renderer.project_and_bin(gaussians, camera)
            stages.add_row(*label, f"{binned.order.size:,}", *(f"{1e3 * t:.1f}" for t in times))

            rate, drawn = pairs_a_second(), pairs_drawn(binned, camera)
            alone = [
                single.render_timed(gaussians, camera, clock=time.thread_time)[1] for _ in runs
            ]
            points.append((width * height, count, min(timing.total for timing in alone)))
            blend = min(timing.blend for timing in alone)
            ratio = blend * rate / drawn
            verdict = " ok" if ratio <= BLEND_BAR else " above the bar"
            limits.add_row(
                *(*label, f"{drawn:,}", f"{rate / 1e9:.2f}", f"{1e3 * drawn / rate:.1f}"),
                *(f"{1e3 * blend:.1f}", f"{ratio:.1f}{verdict if count <= 200_000 else ''}"),
            )
    console.print(stages)
    (constant, per_pixel, per_gaussian), explained = linear_fit(points)
    console.print(
        f"Fit, one core, processor time: {1e3 * constant:.1f} ms + {1e9 * per_pixel:.0f} ns a "
        f"pixel + {1e6 * per_gaussian:.3f} us a Gaussian; R^2 = {explained:.3f}"
    )
    console.print(limits)
    console.print(
        "In processor time, so that other work on the machine does not count. A pair is drawn "
        "where its alpha is 1/255 or more, before the stop. "
        f"Bar: {BLEND_BAR:.0f}, up to 200,000 Gaussians."
    )
    console.print(growth_table(measure_growth(min(arguments.repeats, 5))))
    console.print(sharing_table(measure_sharing()))
    if not arguments.without_torch:
        console.print(torch_table(renderer, arguments.repeats))


def torch_table(renderer: NumbaRenderer, repeats: int) -> Table:
    """The CPU renderer and the torch reference in turns, 200,000 Gaussians at 640 x 480."""
    gaussians, camera = surface_scene(200_000), corner_camera(640, 480)
    table = Table("renderer", title="200,000 Gaussians, 640x480: against the torch reference")
    for name in ("ms", "ratio"):
        table.add_column(name, justify="right")
    twins = [TorchReference(torch.float32), TorchReference(torch.float64)]
    times = {twin.name: float("inf") for twin in twins}
    ours, usual = float("inf"), torch.get_num_threads()
    for threads in (1, usual):  # torch's threads can cost more than they bring on a busy machine
        torch.set_num_threads(threads)
        for twin in twins:
            seconds = seconds_of(lambda twin=twin: twin.render(gaussians, camera))
            times[twin.name] = min(times[twin.name], seconds)
            for _ in range(repeats):
                ours = min(ours, seconds_of(lambda: renderer.render(gaussians, camera)))
    torch.set_num_threads(usual)
    table.add_row(renderer.name, f"{1e3 * ours:.1f}", "")
    for name, seconds in times.items():
        verdict = "ok" if seconds / ours >= TORCH_BAR else "below the bar"
        table.add_row(name, f"{1e3 * seconds:.0f}", f"{seconds / ours:.0f}x {verdict}")
    table.caption = f"the better of 1 and {usual} torch threads; bar: {TORCH_BAR:.0f}x"
    return table


if __name__ == "__main__":
    main()
