"""How fast the CPU renderer is: ``python benchmarks/render_speed.py``.

Prints the time of each stage (minima over repeats), the ratio to the torch reference, and the
ratio of blending to what its arithmetic alone would take on the same machine in the same minute;
then how renders grow with Gaussians and with pixels, and what pictures and masks cost together.

The scenes are those of ``render_scene``.
"""

from __future__ import annotations

import argparse
import os
import time

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from render_growth import growth_table, measure_growth, measure_sharing, sharing_table
from render_scene import corner_camera, seconds_of, surface_scene
from rich.console import Console
from rich.table import Table

from gvr_core.cameras import Camera
from gvr_core.rendering.blending import STATE, blend_row
from gvr_core.rendering.layout import MEAN_X, MEAN_Y, T0, T_MIN, TILE, A, B, C
from gvr_core.rendering.numba_renderer import Binned, NumbaRenderer, StageSeconds
from gvr_core.rendering.torch_reference import TorchReference

SIZES = ((640, 480), (988, 731))
TORCH_BAR, BLEND_BAR = 20.0, 7.0


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
