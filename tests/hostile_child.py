"""Reads every file of `hostile_files` in a process of its own, and says what each cost: JSON."""

from __future__ import annotations

import atexit
import json
import resource
import shutil
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.extend(str(ROOT / folder) for folder in ("", "tests", "tests/reports"))


def main() -> None:
    """A line for each file: its name, what came out, seconds, bytes that the peak grew by."""
    import hostile_files
    from hostile_targets import TARGETS

    from gvr_core.errors import GVRError
    from tasks.measure import peak_resident

    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    files = hostile_files.crafted()
    for target in {target for target, _ in files.values()}:
        (folder / target).mkdir()
        (folder / f"{target}-seeds").mkdir()
        # Libraries that reading imports are nobody's promise.
        for seed in TARGETS[target].seeds(folder / f"{target}-seeds"):
            TARGETS[target].read(seed, folder / target)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + 2**31
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    for name, (target, data) in files.items():
        before, began = peak_resident(), time.monotonic()
        try:
            TARGETS[target].read(data, folder / target)
            outcome = "accepted"
        except GVRError as error:
            outcome = f"refused: {str(error)[:200]}"
        except Exception as error:
            outcome = f"{type(error).__name__}: {error}"[:300]
        seconds, grown = time.monotonic() - began, peak_resident() - before
        print(json.dumps([name, outcome, seconds, grown, len(data)]), flush=True)


main()
