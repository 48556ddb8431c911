"""Small files that promise a lot, and what a fuzzer found: refused, at once and within memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest
from hostile_files import FOUND, crafted

CHILD = Path(__file__).resolve().parent.parent / "hostile_child.py"
SECONDS = 10.0
MEMORY = 64 * 2**20


class Cost(NamedTuple):
    """What reading one file came to."""

    name: str
    outcome: str
    seconds: float
    grown: int
    size: int


@pytest.fixture(scope="module")
def costs() -> dict[str, Cost]:
    """All files, read in one process that may take 2 GiB more than it began with."""
    done = subprocess.run(
        [sys.executable, str(CHILD)], capture_output=True, text=True, timeout=300, check=False
    )
    listed = [Cost(*json.loads(line)) for line in done.stdout.splitlines()]
    assert done.returncode == 0, f"ended after {listed[-1:]}: {done.stderr[-2000:]}"
    return {cost.name: cost for cost in listed}


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("name", crafted())
def test_it_costs_next_to_nothing(costs: dict[str, Cost], name: str) -> None:
    cost = costs[name]
    assert cost.outcome.startswith(("refused: ", "accepted")), cost
    assert cost.seconds < SECONDS, cost
    assert cost.grown < MEMORY, cost


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_what_promises_too_much_is_refused(costs: dict[str, Cost]) -> None:
    kept = {"500 objects of 79 million pixels"}
    found = {path.stem for path in FOUND.glob("*.bin")}
    accepted = {cost.name for cost in costs.values() if cost.outcome == "accepted"}
    assert accepted <= kept | found
