"""Charts of a report: matplotlib's SVG, with text as text, in the page's own ink.

SVG of 10 to 40 KB stands in for a charting library of 5 MB: the charts need no zoom, print as they
are, and every number of theirs is in the table below them.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib as mpl
from markupsafe import Markup
from matplotlib.figure import Figure

from reports.bootstrap import Estimate
from reports.sheet import printable

BLUE, ORANGE, GREY = "#0072b2", "#d55e00", "#8a8f98"
STAGE_COLOURS = (
    "#0072b2",
    "#56b4e9",
    "#009e73",
    "#f0e442",
    "#999999",
    "#e69f00",
    "#d55e00",
    "#cc79a7",
)
"""Okabe and Ito's palette, for every kind of colour vision; one for each stage."""
HATCHES = ("", "///", "", "...", "", "\\\\\\", "", "xxx")

_INK = "#010203"
"""Stands for the page's ink, which differs between light and dark."""
_WIDTH = 6.4
_FONT = 9.5


@dataclass(frozen=True)
class Interval:
    """A line of an interval chart."""

    label: str
    estimate: Estimate


def interval_chart(lines: Sequence[Interval], axis: str, factor: float = 100.0) -> Markup:
    """Estimates with their intervals, one under the other, zero marked.

    Args:
        lines: From top to bottom.
        axis: What is shown, with its unit.
        factor: What each number is multiplied with.
    """
    with mpl.rc_context(_settings()):
        tall = 0.55 + 0.3 * len(lines)
        figure = Figure(figsize=(_WIDTH, tall))
        axes = figure.add_axes((0.36, 0.45 / tall, 0.60, 0.3 * len(lines) / tall))
        for y, line in enumerate(lines):
            e = line.estimate
            value = low = high = factor * e.value
            sure = e.low is not None and e.high is not None
            if e.low is not None and e.high is not None:
                low, high = factor * e.low, factor * e.high
            # Away from zero or not is said by the marker too, not by colour alone.
            clear = sure and (low > 0 or high < 0)
            colour = (BLUE if value > 0 else ORANGE) if clear else GREY
            axes.plot([low, high], [y, y], color=colour, linewidth=2.4, solid_capstyle="butt")
            axes.plot(
                [value], [y], "o", color=colour, markersize=6,
                markerfacecolor=colour if clear else "none", markeredgewidth=1.6,
            )  # fmt: skip
        axes.axvline(0, color=_INK, linewidth=0.8)
        axes.set_yticks(range(len(lines)), [_short(line.label) for line in lines])
        axes.set_ylim(len(lines) - 0.5, -0.5)
        axes.set_xlabel(axis)
        _plain(axes)
        return _svg(figure, f"{axis} {lines}")


def stage_chart(
    labels: Sequence[str], stages: Sequence[str], seconds: Sequence[Sequence[float]]
) -> Markup:
    """Stacked bars: how the time of each line is shared among the stages.

    Args:
        labels: Lines, from top to bottom.
        stages: Stages, from left to right.
        seconds: For each line the seconds of each stage.
    """
    with mpl.rc_context(_settings()):
        tall = 1.25 + 0.34 * len(labels)
        figure = Figure(figsize=(_WIDTH, tall))
        axes = figure.add_axes((0.26, 0.45 / tall, 0.70, 0.34 * len(labels) / tall))
        for y, row in enumerate(seconds):
            left = 0.0
            for i, value in enumerate(row):
                axes.barh(
                    y, value, 0.66, left=left, label=stages[i] if y == 0 else None,
                    color=STAGE_COLOURS[i % len(STAGE_COLOURS)],
                    hatch=HATCHES[i % len(HATCHES)], edgecolor="#1b1e23", linewidth=0.5,
                )  # fmt: skip
                left += value
            axes.text(left, y, f" {left:.0f}", va="center", ha="left")
        axes.set_yticks(range(len(labels)), [_short(label) for label in labels])
        axes.set_ylim(len(labels) - 0.5, -0.5)
        axes.set_xlim(0, 1.1 * max(1e-9, *(sum(row) for row in seconds)))
        axes.set_xlabel("seconds a scene, all its queries")
        figure.legend(loc="upper left", ncol=4, frameon=False, bbox_to_anchor=(0.0, 1.0))
        _plain(axes)
        return _svg(figure, f"{labels} {seconds}")


def _settings() -> dict[str, object]:
    return {
        "svg.fonttype": "none",
        "svg.hashsalt": "gvr",
        "font.family": "sans-serif",
        "font.size": _FONT,
        "text.color": _INK,
        "text.parse_math": False,  # a name with a dollar sign is a name
        "axes.edgecolor": _INK,
        "axes.labelcolor": _INK,
        "xtick.color": _INK,
        "ytick.color": _INK,
        "hatch.linewidth": 0.6,
    }


def _plain(axes: mpl.axes.Axes) -> None:
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color=GREY, alpha=0.35, linewidth=0.6)
    axes.set_axisbelow(True)


def _short(label: str) -> str:
    shown = printable(label)
    return shown if len(shown) <= 30 else f"{shown[:29]}…"


def _svg(figure: Figure, salt: str) -> Markup:
    file = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": salt}):  # ids of two charts on a page differ
        figure.savefig(file, format="svg", transparent=True, metadata={"Date": None})
    text = file.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = text.replace(_INK, "currentColor")
    # The page's own font, and the chart as wide as there is room.
    text = re.sub(r"font: ([0-9.]+)px [^;\"]*", r"font-size: \1px; font-family: inherit", text)
    text = re.sub(r'<svg ([^>]*?)width="[^"]*"', r"<svg \1", text, count=1)
    text = re.sub(r'<svg ([^>]*?)height="[^"]*"', r"<svg \1", text, count=1)
    return Markup(text)
