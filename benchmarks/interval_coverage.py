"""How often the comparison's intervals hold the true mean.

    python benchmarks/interval_coverage.py

Scene means are drawn from a standard normal distribution, 2,000 benchmarks for each number of
scenes.
"""

from __future__ import annotations

import numpy as np

from reports.bootstrap import interval

BENCHMARKS = 2_000


def coverage(n_scenes: int, rng: np.random.Generator) -> float:
    """Share of the intervals that hold 0, the true mean."""
    held = 0
    for means in rng.normal(size=(BENCHMARKS, n_scenes)):
        found = interval({str(scene): [float(mean)] for scene, mean in enumerate(means)})
        if found is None or found.low is None or found.high is None:
            raise RuntimeError(f"no interval for {n_scenes} scenes")
        held += found.low <= 0 <= found.high
    return held / BENCHMARKS


if __name__ == "__main__":
    for n_scenes in (4, 10, 30):
        print(
            f"{n_scenes:2d} scenes: {coverage(n_scenes, np.random.default_rng(0)):.2f}", flush=True
        )
