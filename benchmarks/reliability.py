"""What GVR-Bench survives: faults made on purpose, counted.

    python benchmarks/reliability.py                            # all; prints the table
    python benchmarks/reliability.py --into docs/reliability.md # and puts it there
    python benchmarks/reliability.py --quick --only points      # a short form of one part

Exit code 1 where something was lost.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

_TESTS = Path(__file__).resolve().parents[1] / "tests"
sys.path[:0] = [str(_TESTS), str(_TESTS / "reports")]

from faults.lines import Line, markdown
from faults.parts import PARTS, Bench
from faults.work import make_work
from reports.document import replace_block
from reports.environment import describe_environment

COMMAND = "python benchmarks/reliability.py"


def main(
    only: Annotated[
        list[str] | None, typer.Option(help=f"Only this part: {', '.join(PARTS)}.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A short form of each part.")] = False,
    kills: Annotated[int, typer.Option(help="Kills of whole runs at random moments.")] = 50,
    seed: Annotated[int, typer.Option(help="Of random moments and places.")] = 20261125,
    into: Annotated[
        Path | None, typer.Option(help="Put the table between <!-- reliability --> lines there.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the lines as JSON.")] = False,
) -> None:
    """Try each fault, count what survived, and print the table."""
    unknown = set(only or []) - set(PARTS)
    if unknown:
        raise typer.BadParameter(f"{', '.join(sorted(unknown))} (accepted: {', '.join(PARTS)})")
    lines: list[Line] = []
    with tempfile.TemporaryDirectory(prefix="gvr-faults-") as folder:
        bench = Bench(Path(folder), make_work(Path(folder)), seed, quick, kills)
        for name, part in PARTS.items():
            if only and name not in only:
                continue
            started = time.monotonic()
            for line in part(bench):
                lines.append(line)
                print(
                    f"{name}: {line.fault}: {line.survived} of {line.tried} survived {line.note}"
                    f"{line.skipped and 'skipped: ' + line.skipped}",
                    file=sys.stderr,
                )
                for loss in line.losses:
                    print(f"    {loss}", file=sys.stderr)
            print(f"{name}: {time.monotonic() - started:.0f} s", file=sys.stderr, flush=True)
    machine = describe_environment()
    where = f"{machine.cpu_count} x {machine.processor}, {machine.platform}; seed {seed}."
    table = f"{markdown(lines, COMMAND)}\n\n{where}"
    print(json.dumps([asdict(line) for line in lines]) if as_json else table)
    if into is not None:
        replace_block(into, "reliability", table)
    if any(line.lost for line in lines):
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(main)
