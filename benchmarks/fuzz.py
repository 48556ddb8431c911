"""Feed every parser files that a fuzzer makes up: ``python benchmarks/fuzz.py --target all``.

Guided by the coverage of our own modules (atheris, on libFuzzer), from valid small files on. Each
target runs in a process of its own that may take 2 GiB more of address space than it starts with;
an input may take ten seconds and add 64 MiB to the peak of its memory. A finding is an input that
breaks one of these, or lets anything but a ``GVRError`` out. Findings are saved with what came
out; those that are mended belong into ``tests/data/hostile``.
"""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

ROOT = Path(__file__).resolve().parent.parent
sys.path.extend(str(ROOT / folder) for folder in ("", "tests", "tests/reports"))

BLOCK = "fuzz"
"""Name of the block of the page that ``--into`` rewrites."""

INPUT_SECONDS = 10
"""An input that takes longer is a finding."""

INPUT_MEMORY = 64
"""MiB that an input may add to the peak of the resident memory."""


@dataclass(frozen=True)
class Run:
    """What fuzzing one target came to."""

    target: str
    executions: int
    edges: int
    features: int
    corpus: int
    """Inputs kept since each reached something new."""
    findings: int
    peak_mib: int
    seconds: int


def fuzz(name: str, runs: int, seconds: int, seed: int, folder: Path) -> Run:
    """Fuzz one target.

    Args:
        name: Of the target.
        runs: Executions at most; -1 for any number.
        seconds: Wall time at most, without the start.
        seed: Of the fuzzer's random numbers.
        folder: Gets ``corpus/<name>/`` and ``findings/``, and keeps what is there.
    """
    from hostile_targets import BROKEN, TARGETS

    corpus, findings = folder / "corpus" / name, folder / "findings"
    for place in (corpus, findings):
        place.mkdir(parents=True, exist_ok=True)
    words = folder / f"{name}.dict"
    lines = [
        '"' + "".join(f"\\x{byte:02x}" for byte in word.encode()) + '"\n'
        for word in TARGETS.get(name, BROKEN).words
    ]
    words.write_text("".join(lines))
    command = [
        *(sys.executable, str(ROOT / "benchmarks" / "fuzz_child.py")),
        *(name, str(findings), str(INPUT_MEMORY)),
        *(f"-runs={runs}", f"-max_total_time={seconds}", f"-seed={seed}"),
        *(f"-timeout={INPUT_SECONDS}", "-rss_limit_mb=6000", "-max_len=65536", "-len_control=20"),
        *("-print_final_stats=1", f"-artifact_prefix={findings}/{name}-", "-detect_leaks=0"),
        *([f"-dict={words}"] if lines else []),
        str(corpus),
    ]
    # Any log of the libraries below would drown the fuzzer's own lines.
    quiet = {"PYTHONWARNINGS": "ignore", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    log = folder / f"{name}.log"
    memory = "/dev/shm" if Path("/dev/shm").is_dir() else None
    with log.open("wb") as output, tempfile.TemporaryDirectory(dir=memory) as scratch:
        done = subprocess.run(
            command,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=os.environ | quiet | {"TMPDIR": scratch},
            timeout=None if seconds <= 0 else seconds + 300,
            check=False,
        )
    text = log.read_text(errors="replace")
    if not re.search(r"stat::number_of_executed_units|cov: ", text):
        raise RuntimeError(f"{name} ended with {done.returncode} before it began: {text[-2000:]}")
    steps = re.findall(r"#(\d+)\s.*?cov: (\d+) ft: (\d+)(?: corp: (\d+))?", text)
    stats = dict(re.findall(r"stat::(\w+):\s+(\d+)", text))
    last = steps[-1] if steps else ("0", "0", "0", "0")
    kept = [p for p in findings.glob(f"{name}-*") if p.suffix != ".txt"]
    took = re.search(r"Done \d+ runs in (\d+) second", text)
    return Run(
        name,
        int(stats.get("number_of_executed_units", last[0])),
        int(last[1]),
        int(last[2]),
        sum(1 for _ in corpus.iterdir()),
        len(kept),
        int(stats.get("peak_rss_mb", 0)),
        int(took[1]) if took else seconds,
    )


def table(runs: list[Run]) -> str:
    """The runs as Markdown."""
    lines = [
        "| target | executions | edges | features | corpus | findings | peak MiB | seconds |",
        "| :--- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for run in runs:
        numbers = (run.executions, run.edges, run.features, run.corpus, run.findings, run.peak_mib)
        cells = " | ".join(f"{number:,}" for number in (*numbers, run.seconds))
        lines.append(f"| {run.target} | {cells} |")
    executions, findings = (sum(getattr(r, k) for r in runs) for k in ("executions", "findings"))
    lines.append(
        f"| all | {executions:,} | | | | {findings} | | {sum(r.seconds for r in runs):,} |"
    )
    return "\n".join(lines)


def main(
    target: Annotated[str, typer.Option(help="A target's name, a part of it, or all.")] = "all",
    runs: Annotated[int, typer.Option(help="Executions of a target at most; -1: any number.")] = -1,
    seconds: Annotated[int, typer.Option(help="Seconds of a target at most.")] = 10,
    seed: Annotated[int, typer.Option(help="Of the fuzzer's random numbers.")] = 1,
    folder: Annotated[Path | None, typer.Option(help="Keeps corpus and findings.")] = None,
    into: Annotated[
        Path | None, typer.Option(help=f"Page with a block <!-- {BLOCK} --> for the table.")
    ] = None,
) -> None:
    """Fuzz, print the table, and end with 1 if anything was found."""
    from hostile_targets import TARGETS

    from reports.document import replace_block

    if importlib.util.find_spec("atheris") is None:
        print("atheris is not installed: it exists for Linux, among what tests need")
        raise typer.Exit(2)
    names = [name for name in TARGETS if target in (name, "all")]
    names = names or [name for name in TARGETS if target in name]
    if not names:
        print(f"no target {target!r}; there are: {', '.join(TARGETS)}")
        raise typer.Exit(2)
    place = folder or Path(tempfile.mkdtemp(prefix="gvr-fuzz-"))
    done = []
    for name in names:
        done.append(fuzz(name, runs, seconds, seed, place))
        print(done[-1], flush=True)
    text = table(done)
    print(f"\n{text}\n\ncorpus and findings: {place}")
    if into is not None:
        replace_block(into, BLOCK, text)
    if any(run.findings for run in done):
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(main)
