"""What GVR-Bench survives: faults made on purpose, counted.

    python benchmarks/reliability.py                            # all; prints the table
    python benchmarks/reliability.py --into docs/reliability.md # and puts it there
    python benchmarks/reliability.py --quick --only points      # a short form of one part

Exit code 1 where something was lost.
"""

from __future__ import annotations

import sys
from pathlib import Path

import typer

TESTS = Path(__file__).resolve().parents[1] / "tests"


def run() -> None:
    """Run the script that lies with the tests, whose short form it shares."""
    sys.path[:0] = [str(TESTS.parent), str(TESTS)]
    from faults.script import main

    typer.run(main)


if __name__ == "__main__":
    run()
