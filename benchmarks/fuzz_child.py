"""One fuzz target in a process of its own; started by ``fuzz.py``, which says what it means."""

from __future__ import annotations

import hashlib
import resource
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import atheris

ROOT = Path(__file__).resolve().parent.parent
OURS = ("gvr_core", "datasets", "tasks", "flows", "reports")

# Compiled by numba from their byte code, which must be the compiler's own.
COMPILED = ("gvr_core.rendering", "gvr_core.robust", "gvr_core.metrics")


def main() -> None:
    """Run the target that the first argument names; the others are libFuzzer's."""
    name, crashes, memory = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]) * 2**20
    sys.path.extend(str(ROOT / folder) for folder in ("", "tests", "tests/reports"))
    with atheris.instrument_imports(include=list(OURS), exclude=list(COMPILED)):
        from hostile_targets import BROKEN, TARGETS

        from tasks.measure import peak_resident

        target = {BROKEN.name: BROKEN, **TARGETS}[name]
        folder = Path(tempfile.mkdtemp())
        seeds = target.seeds(_made(folder / "seeds"))
        place = _made(folder / "run")
        # What is imported on the way is instrumented too, and counts as nobody's memory.
        for seed in seeds:
            _outcome(target.read, seed, place)
    corpus = _made(Path(sys.argv[-1]))
    for seed in seeds:
        (corpus / hashlib.sha256(seed).hexdigest()[:16]).write_bytes(seed)
    _limit_address_space(2**31)

    def one(data: bytes) -> None:
        before = peak_resident()
        error = _outcome(target.read, data, place)
        grown = peak_resident() - before
        if error is not None:
            _keep(crashes, name, _kind(error), data, "".join(traceback.format_exception(error)))
        if grown > memory:
            _keep(crashes, name, "memory", data, f"the peak grew by {grown / 2**20:.0f} MiB")

    options: dict[str, Any] = {}
    if seeds[0][:1] in (b"[", b"{"):
        options["custom_mutator"] = _json_mutator()
    atheris.Setup([sys.argv[0], *sys.argv[4:]], one, **options)
    atheris.Fuzz()


def _json_mutator() -> Callable[[bytes, int, int], bytes]:
    """Half of the texts are changed as JSON: few that are changed as bytes get past the parser."""
    from hostile_json import mutated

    def mutate(data: bytes, most: int, seed: int) -> bytes:
        if seed % 2:
            try:
                made = mutated(data, seed)
            except (ValueError, RecursionError):
                made = b""
            if 0 < len(made) <= most:
                return made
        return bytes(atheris.Mutate(data, len(data)) if data else b"{}")

    return mutate


def _outcome(read: object, data: bytes, place: Path) -> Exception | None:
    """What comes out that is no error of the project's own."""
    from gvr_core.errors import GVRError

    try:
        read(data, place)  # type: ignore[operator]
    except GVRError:
        return None
    except Exception as error:
        return error
    return None


def _kind(error: Exception) -> str:
    """The error's type, and the innermost line of the project that it passed."""
    steps = traceback.extract_tb(error.__traceback__)
    ours = [s for s in steps if Path(s.filename).is_relative_to(ROOT) and "fuzz" not in s.filename]
    where = f"{Path(ours[-1].filename).stem}-{ours[-1].lineno}" if ours else "nowhere"
    return f"{type(error).__name__}-{where}"


def _keep(crashes: Path, name: str, kind: str, data: bytes, text: str) -> None:
    """One input of each kind, the smallest."""
    path = crashes / f"{name}-{kind}.bin"
    if not path.exists() or path.stat().st_size > len(data):
        path.write_bytes(data)
        path.with_suffix(".txt").write_text(text)


def _limit_address_space(more: int) -> None:
    """Let the process have so many bytes more than it has now."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + more
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


if __name__ == "__main__":
    main()
