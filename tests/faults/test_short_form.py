"""A short form of ``benchmarks/reliability.py``: every fault is tried, and nothing is lost."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
QUICK = ("points", "races", "disk", "damage", "memory")
SLOW = ("kills", "full-runs", "prefect", "tracking")


def tried(parts: tuple[str, ...], *options: str) -> dict[str, list[dict[str, Any]]]:
    """The lines of some parts, tried in a process of its own, which may fork."""
    memory = Path("/dev/shm")
    # Thousands of small files are synced: that is to wait for no disk.
    places = {"TMPDIR": str(memory)} if os.access(memory, os.W_OK) else {}
    chosen = [word for part in parts for word in ("--only", part)]
    done = subprocess.run(
        [sys.executable, "benchmarks/reliability.py", "--quick", "--json", *chosen, *options],
        cwd=REPOSITORY,
        env={**os.environ, **places},
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert done.stdout, done.stderr
    lines = json.loads(done.stdout)
    return {part: [line for line in lines if line["part"] == part] for part in parts}


def assert_survived(lines: list[dict[str, Any]]) -> None:
    assert lines
    for line in lines:
        if line["skipped"]:
            pytest.skip(line["skipped"])
        assert line["losses"] == [], line["fault"]
        assert line["survived"] == line["tried"] > 0, line["fault"]


@pytest.fixture(scope="module")
def quick() -> dict[str, list[dict[str, Any]]]:
    return tried(QUICK)


@pytest.mark.parametrize("part", QUICK)
def test_nothing_is_lost(quick: dict[str, list[dict[str, Any]]], part: str) -> None:
    assert_survived(quick[part])


@pytest.mark.slow
@pytest.mark.parametrize("part", SLOW)
def test_nothing_is_lost_with_real_servers(part: str) -> None:
    assert_survived(tried((part,), "--kills", "2")[part])
