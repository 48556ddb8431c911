"""What the speed benchmarks share: medians with their spread, straight fits, Markdown tables."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Spread:
    """Some repeats of one measurement."""

    median: float
    least: float
    most: float
    repeats: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Of one value or more.

        Raises:
            ValueError: without any.
        """
        if not values:
            raise ValueError("no value to take the median of")
        return cls(statistics.median(values), min(values), max(values), len(values))

    def scaled(self, factor: float) -> Spread:
        """Every figure times a positive number."""
        return Spread(self.median * factor, self.least * factor, self.most * factor, self.repeats)

    def shown(self, unit: float = 1.0, digits: int = 1) -> str:
        """``median (least-most)`` in units, e.g. 1e-3 for milliseconds out of seconds."""
        numbers = (f"{value / unit:,.{digits}f}" for value in (self.median, self.least, self.most))
        return "{} ({}-{})".format(*numbers)


def spread_of(
    work: Callable[[], object],
    repeats: int,
    warm: int = 1,
    clock: Callable[[], float] = time.perf_counter,
) -> Spread:
    """Seconds of some work.

    Args:
        work: Called ``warm + repeats`` times.
        repeats: Measured.
        warm: Calls before, not measured.
        clock: Gives the time, seconds.
    """
    for _ in range(warm):
        work()
    times = []
    for _ in range(repeats):
        start = clock()
        work()
        times.append(clock() - start)
    return Spread.of(times)


@dataclass(frozen=True)
class Line:
    """seconds = constant + slope * x, by least squares."""

    constant: float
    slope: float
    explained: float
    """R^2; 1 where all points lie on the line."""


def straight_fit(x: Sequence[float], y: Sequence[float]) -> Line:
    """The line through some points that is nearest in y, each point counting by its own size.

    Residuals are taken relative to y: else only the largest point would decide.

    Args:
        x: Two different values or more.
        y: As many, all positive.

    Raises:
        ValueError: for fewer, or a y that is not positive.
    """
    if len(x) != len(y) or len(set(x)) < 2 or min(y, default=0) <= 0:
        raise ValueError(f"no line through x {list(x)} and y {list(y)}")
    xs, ys = np.asarray(x, np.float64), np.asarray(y, np.float64)
    design = np.column_stack([np.ones_like(xs), xs]) / ys[:, None]
    (constant, slope), *_ = np.linalg.lstsq(design, np.ones_like(ys), rcond=None)
    rest = ys - constant - slope * xs
    spread = float(((ys - ys.mean()) ** 2).sum())
    explained = 1 - float(rest @ rest) / spread if spread > 0 else 1.0
    return Line(float(constant), float(slope), explained)


@dataclass(frozen=True)
class Bar:
    """A bar, and how a run stands against it."""

    what: str
    measured: float
    limit: float
    unit: str
    at_least: bool = False
    """Whether the measured figure has to reach the limit, instead of staying below it."""

    @property
    def met(self) -> bool:
        """Whether it is."""
        return self.measured >= self.limit if self.at_least else self.measured <= self.limit

    def cells(self) -> tuple[str, str, str, str]:
        """A row of the table of bars."""
        sign = ">=" if self.at_least else "<="
        return (
            self.what,
            f"{self.measured:.3g} {self.unit}",
            f"{sign} {self.limit:.3g} {self.unit}",
            "met" if self.met else "**missed**",
        )


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; the first column is left-aligned, the others right.

    Raises:
        ValueError: for a row that is not as long as the head.
    """
    for row in rows:
        if len(row) != len(head):
            raise ValueError(f"{len(row)} cells under a head of {len(head)}: {list(row)}")
    marks = [":---"] + ["---:"] * (len(head) - 1)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, marks, *rows))
