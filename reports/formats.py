"""Numbers as the tables show them."""

from __future__ import annotations

from reports.bootstrap import Estimate
from reports.headline import Cell

NONE = "–"
"""Stands where there is no number."""


def cell_text(cell: Cell) -> str:
    """A number of the headline in per cent; what is not over everything carries a star."""
    if cell.state == "failed":
        return "failed"
    if cell.state == "none":
        return NONE
    return f"{100 * cell.value:.1f}{'*' if cell.partial else ''}"


def coverage_text(cell: Cell) -> str:
    """Evaluated and expected pairs, ``12/14``; empty where every one was evaluated."""
    if cell.state == "failed" or cell.n >= cell.n_expected:
        return ""
    return f"{cell.n}/{cell.n_expected}"


def seconds_text(value: float | None) -> str:
    """Seconds to three digits."""
    if value is None:
        return NONE
    return f"{value:,.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2f}"


def estimate_text(
    estimate: Estimate | None, spec: str = ".1f", factor: float = 100.0, mark: str = ""
) -> str:
    """A number and its interval, ``52.3 (41.0, 63.1)``; ``52.3 (–)`` where it has none.

    Args:
        estimate: The number.
        spec: How each is written.
        factor: What each is multiplied with; 100 for per cent.
        mark: Stands behind the number.
    """
    if estimate is None:
        return NONE
    shown = f"{format(factor * estimate.value, spec)}{mark}"
    if estimate.low is None or estimate.high is None:
        return f"{shown} ({NONE})"
    low, high = (format(factor * end, spec) for end in (estimate.low, estimate.high))
    return f"{shown} ({low}, {high})"
