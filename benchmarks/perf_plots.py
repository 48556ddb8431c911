"""The picture of docs/performance.md: growth with Gaussians, views and queries."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from growth import Growth
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from measuring import Spread
from render_speed import RenderTimes

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
"""Of Okabe and Ito (2008): told apart by every kind of colour vision."""
MARKERS = ("o", "s", "^", "D")


def growth_picture(grown: Sequence[Growth], renders: Sequence[RenderTimes]) -> bytes:
    """A panel for Gaussians, one for views, one for queries; medians, spread, and lines.

    Args:
        grown: The methods' times.
        renders: The renderer's times.

    Returns:
        A PNG.
    """
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 3)
    drawn = [*grown, *_pictures(renders)]
    for panel, of in zip(panels, ("Gaussians", "views", "queries"), strict=True):
        for number, growth in enumerate(g for g in drawn if g.of == of):
            _draw(panel, growth, number)
        panel.set(xlabel=of, ylabel="seconds", xscale="log", yscale="log")
        sizes = sorted({size for growth in drawn if growth.of == of for size, _ in growth.points})
        panel.set_xticks(sizes, [f"{size:,}" for size in sizes], rotation=30, fontsize=8)
        panel.minorticks_off()
        panel.grid(alpha=0.3)
        panel.legend(fontsize=8)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=120)
    return stream.getvalue()


def _pictures(renders: Sequence[RenderTimes]) -> list[Growth]:
    sizes = dict.fromkeys((times.width, times.height) for times in renders)
    return [
        Growth(
            f"a picture of {width}x{height}",
            "Gaussians",
            tuple(
                (times.gaussians, Spread.of(times.totals))
                for times in renders
                if (times.width, times.height) == (width, height)
            ),
        )
        for width, height in sizes
    ]


def _draw(panel: Axes, growth: Growth, number: int) -> None:
    colour, marker = COLOURS[number % len(COLOURS)], MARKERS[number % len(MARKERS)]
    sizes = np.array([size for size, _ in growth.points], np.float64)
    spreads = [spread for _, spread in growth.points]
    median = np.array([spread.median for spread in spreads])
    ends = np.array([[s.median - s.least for s in spreads], [s.most - s.median for s in spreads]])
    panel.errorbar(
        sizes, median, ends, fmt=marker, color=colour, capsize=3, markersize=5, label=growth.what
    )
    line = growth.fit
    x = np.geomspace(sizes.min(), sizes.max(), 100)
    y = line.constant + line.slope * x
    panel.plot(x[y > 0], y[y > 0], color=colour, linewidth=1)
