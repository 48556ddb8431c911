"""A folder in which a page's shell blocks run as a reader runs them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]


def environment(packages: Sequence[Path] = ()) -> dict[str, str]:
    """This process's environment, with `gvr` and `python` found, and no setting of the project's.

    Args:
        packages: Folders of further installed packages.
    """
    ours = ("GVR_", "PREFECT_", "MLFLOW_")
    kept = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    places = [*map(str, packages), str(REPOSITORY)]
    found = [str(Path(sys.executable).parent), kept.get("PATH", os.defpath)]
    return {
        **kept,
        "PATH": os.pathsep.join(found),
        "PYTHONPATH": os.pathsep.join(places),
        "COLUMNS": "200",
    }


def shell(
    block: str, folder: Path, packages: Sequence[Path] = (), code: int = 0, seconds: float = 600
) -> str:
    """Run a block with sh, ending at the first command that fails; its output.

    Args:
        block: The commands, as the page has them.
        folder: Where they run.
        packages: As of :func:`environment`.
        code: The exit code that is expected.
        seconds: How long it may take.
    """
    done = subprocess.run(
        ["sh", "-eu", "-c", block],
        cwd=folder,
        env=environment(packages),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=seconds,
        check=False,
    )
    assert done.returncode == code, done.stdout
    return done.stdout
