"""The fuzzer in its short form: it finds what is broken on purpose, and nothing else."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("atheris", reason="the fuzzer exists for Linux only")

sys.path.append(str(Path(__file__).resolve().parent.parent.parent / "benchmarks"))
from fuzz import Run, fuzz, table

pytestmark = pytest.mark.slow


def test_it_finds_what_is_broken_on_purpose(tmp_path: Path) -> None:
    run = fuzz("broken", 3000, 60, 1, tmp_path)
    assert run.findings == 2
    kinds = {path.stem.split("-")[1] for path in (tmp_path / "findings").glob("*.bin")}
    assert kinds == {"KeyError", "memory"}


@pytest.mark.parametrize(
    "name", ["ply", "transforms-json", "lerf-labels", "stage-record", "prefect-result"]
)
def test_it_finds_nothing_else(tmp_path: Path, name: str) -> None:
    run = fuzz(name, 2000, 60, 1, tmp_path)
    assert run.findings == 0, [
        path.read_text() for path in (tmp_path / "findings").glob("*.txt")
    ] or sorted((tmp_path / "findings").iterdir())
    assert run.executions >= 1000
    assert run.edges > 10


def test_the_table_adds_up() -> None:
    rows = table([Run("a", 1000, 5, 7, 3, 0, 90, 4), Run("b", 2, 1, 1, 1, 1, 80, 1)]).splitlines()
    assert rows[2] == "| a | 1,000 | 5 | 7 | 3 | 0 | 90 | 4 |"
    assert rows[-1] == "| all | 1,002 | | | | 1 | | 5 |"
