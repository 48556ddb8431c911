"""What an evaluation protocol takes and gives.

A protocol is a named and versioned way to score a prompt in a view. Its id, e.g.
``lerf_ovs.langsplat_2d/1``, stands with every number that it gives: numbers of two protocols are
never averaged, and never compared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float32]
Box = tuple[float, float, float, float]
"""x0, y0, x1, y1 in pixels, ends inclusive, as the LERF labels have it."""
Metrics = dict[str, float]
"""Metric name -> value; what is undefined is left out, never NaN."""


@dataclass(frozen=True, eq=False)
class ViewPrediction:
    """What a method says of one prompt in one view, at the truth's resolution."""

    soft: FloatArray
    """(H, W) in [0, 1]: the share of a pixel's colour that comes from the target, the rest of the
    scene occluding it; or the grey value of a mask that was given."""
    isolated: FloatArray | None = None
    """(H, W) in [0, 1]: opacity of the target's Gaussians drawn alone; None for given masks."""
    relevancy: FloatArray | None = None
    """(L, H, W) relevancy maps, one for each level of granularity, where these were given."""
    pixel: tuple[float, float] | None = None
    """The projected L_3D (x, y); None where there is none, or it lies behind the camera."""
    missing: bool = False
    """Whether nothing was given for this prompt and view; ``soft`` is then zero everywhere."""


@dataclass(frozen=True, eq=False)
class ViewTruth:
    """The labels of one prompt in one view."""

    mask: BoolArray
    """(H, W); where the same prompt is labelled several times, their union."""
    boxes: tuple[Box, ...]
    """The labels' boxes; the box of the mask where the labels have none; none for an empty mask."""


ScorePair = Callable[[ViewPrediction, ViewTruth], Metrics | None]
"""Scores one prompt in one view; None where the pair is left out, and counted."""

ScoreView = Callable[
    [Mapping[str, ViewPrediction], Mapping[str, ViewTruth]], Mapping[str, Metrics | None]
]
"""Scores all prompts of a view together, which compete for its pixels: prompt -> metrics."""


@dataclass(frozen=True)
class ProtocolSpec:
    """A protocol, and how its numbers are averaged and shown."""

    id: str
    """``family.name/version``."""
    about: str
    """One line: what it scores, and whose evaluator it follows."""
    source: str
    """Repository and file that it was read from."""
    mean: Literal["flat", "class"]
    """Which mean of a scene is the protocol's own: over all (prompt, view) pairs, or over the
    views of each prompt first and then over prompts."""
    headline: tuple[tuple[str, str], ...]
    """(metric, title in tables), the protocol's main numbers in order."""
    score_pair: ScorePair | None = None
    score_view: ScoreView | None = None
    """At most one of the two is there; neither for protocols that score no views."""
    needs_isolated: bool = False
    """Whether it looks at :attr:`ViewPrediction.isolated`, which costs a render."""
