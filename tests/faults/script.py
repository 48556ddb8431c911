"""The script that tries every fault; ``python benchmarks/reliability.py`` starts it."""

from __future__ import annotations

import json
import sys
import tempfile
import time
from dataclasses import asdict
from datetime import date
from pathlib import Path
from typing import Annotated

import typer

from faults.lines import Line, markdown
from faults.parts import PARTS, Bench
from faults.work import make_work
from reports.document import replace_block
from reports.environment import describe_environment

COMMAND = "python benchmarks/reliability.py"


def _try(name: str, bench: Bench) -> list[Line]:
    """One part's lines; says on standard error how it goes."""
    started = time.monotonic()
    lines = []
    for line in PARTS[name](bench):
        lines.append(line)
        ending = f"skipped: {line.skipped}" if line.skipped else line.note
        told = [f"{name}: {line.fault}: {line.survived} of {line.tried} survived; {ending}"]
        told += [f"    {loss}" for loss in line.losses]
        print("\n".join(told), file=sys.stderr, flush=True)
    print(f"{name}: {time.monotonic() - started:.0f} s", file=sys.stderr, flush=True)
    return lines


def main(
    only: Annotated[
        list[str] | None, typer.Option(help=f"Only this part: {', '.join(PARTS)}.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A short form of each part.")] = False,
    kills: Annotated[int, typer.Option(help="Kills of whole runs at random moments.")] = 50,
    seed: Annotated[int, typer.Option(help="Of random moments and places.")] = 20261125,
    into: Annotated[
        Path | None,
        typer.Option(
            help="Put each part's table into this file, between <!-- faults.PART --> lines."
        ),
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
        try:
            for name in PARTS:
                if not only or name in only:
                    lines += _try(name, bench)
        finally:
            bench.close()
    machine = describe_environment()
    where = (
        f"{machine.cpu_count} x {machine.processor}, {machine.platform}, {date.today()},"
        f" revision `{(machine.git_revision or 'unknown')[:12]}`; seed {seed}."
    )
    print(json.dumps([asdict(line) for line in lines]) if as_json else markdown(lines, COMMAND))
    if not as_json:
        print(f"\n{where}")
    for name in dict.fromkeys(line.part for line in lines) if into is not None else ():
        own = [line for line in lines if line.part == name]
        replace_block(into, f"faults.{name}", f"{markdown(own, COMMAND)}\n\n{where}")
    if any(line.lost for line in lines):
        raise typer.Exit(1)
