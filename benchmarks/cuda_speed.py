"""How fast the CUDA renderer is, by the name of the card: ``python benchmarks/cuda_speed.py``.

Draws the surfaces of ``render_speed.py`` with gsplat: one view at a time, eight views in one call,
and the weights under 32 masks; each with what belongs to the picture here (median depth, copies
to the host), and beside the CPU renderer in the same run. Without a CUDA GPU or without gsplat it
prints that nothing was measured, and why.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from measuring import Spread, spread_of
from render_scene import corner_camera, surface_scene
from rich.console import Console

from gvr_core.errors import ConfigError
from gvr_core.rendering import get_renderer
from gvr_core.rendering.base import Renderer
from gvr_core.rendering.gsplat_renderer import GsplatRenderer
from gvr_core.rendering.numba_renderer import NumbaRenderer
from reports.document import replace_block
from reports.environment import describe_environment

BLOCK = "cuda-speed"
"""Name of the block of the page that ``--into`` rewrites."""
WIDTH, HEIGHT, VIEWS, MASKS = 640, 480, 8, 32


def table(counts: list[int], repeats: int) -> str:
    """The measurement as Markdown; one line where nothing could be measured."""
    try:
        renderer = get_renderer("gsplat")
    except ConfigError as error:
        return f"Not measured: {error.message}."
    environment = describe_environment()
    lines = [
        f"{environment.gpu}, {renderer.name}; {WIDTH}x{HEIGHT}; milliseconds, median "
        f"(least-most) of {repeats}, copies to the host included.",
        "",
        f"| Gaussians | one view | a view of {VIEWS} in one call | weights under {MASKS} masks | "
        "numba, one view |",
        "| ---: | ---: | ---: | ---: | ---: |",
    ]
    for count in counts:
        cells = [spread.shown(1e-3) for spread in measure(renderer, count, repeats)]
        lines.append(f"| {count:,} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def measure(renderer: Renderer, count: int, repeats: int) -> list[Spread]:
    """Seconds: one view, a view of several, the weights, and one view on the CPU."""
    if not isinstance(renderer, GsplatRenderer):
        raise TypeError(f"{renderer.name} is not the CUDA renderer")
    scene, camera, cpu = surface_scene(count), corner_camera(WIDTH, HEIGHT), NumbaRenderer()
    masks = np.zeros((MASKS, HEIGHT, WIDTH), np.bool_)
    for i in range(MASKS):
        top, left = 120 * (i // 8), 70 * (i % 8)
        masks[i, top : top + 90, left : left + 90] = True
    several = spread_of(lambda: list(renderer.render_many(scene, [camera] * VIEWS)), repeats)
    return [
        spread_of(lambda: renderer.render(scene, camera), repeats),
        several.scaled(1 / VIEWS),
        spread_of(lambda: renderer.weights(scene, camera, masks), repeats),
        spread_of(lambda: cpu.render(scene, camera), repeats),
    ]


def main(
    count: Annotated[list[int] | None, typer.Option(help="Numbers of Gaussians.")] = None,
    repeats: Annotated[int, typer.Option(min=3)] = 12,
    into: Annotated[Path | None, typer.Option(help=f"Page with a block <!-- {BLOCK} -->.")] = None,
) -> None:
    """Measure, print, and put the table into a page."""
    text = table(count or [50_000, 200_000, 1_000_000], repeats)
    Console(soft_wrap=True).print(text, markup=False, highlight=False)
    if into is not None:
        replace_block(into, BLOCK, text)


if __name__ == "__main__":
    typer.run(main)
