"""A process that leaves by `run_and_leave` ends as any other, only sooner."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

BODY = """
import atexit, logging, sys, tempfile, threading, time
from flows.leaving import run_and_leave

atexit.register(print, "exit handler")
folder = tempfile.TemporaryDirectory()
late = threading.Thread(target=lambda: (time.sleep(0.3), print("thread")))

def command():
    late.start()
    print("command", folder.name)
    {end}

run_and_leave(command)
print("never")
"""


@pytest.mark.parametrize(
    ("end", "code", "said"),
    [
        ("return 7", 0, ""),
        ("sys.exit()", 0, ""),
        ("sys.exit(3)", 3, ""),
        ("sys.exit('no such thing')", 1, "no such thing\n"),
    ],
)
def test_it_ends_as_python_does(end: str, code: int, said: str) -> None:
    process = [sys.executable, "-c", BODY.format(end=end)]
    done = subprocess.run(process, capture_output=True, text=True, timeout=60)
    first, *rest = done.stdout.splitlines()
    assert rest == ["thread", "exit handler"]
    assert (done.returncode, done.stderr) == (code, said)
    made = first.split()[1]
    look = [sys.executable, "-c", f"import os; print(os.path.exists({made!r}))"]
    assert subprocess.run(look, capture_output=True, text=True).stdout == "False\n"


def test_an_error_has_its_traceback() -> None:
    process = [sys.executable, "-c", BODY.format(end="raise KeyError('oh')")]
    done = subprocess.run(process, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert done.stderr.startswith("Traceback") and "KeyError: 'oh'" in done.stderr
    assert "exit handler" in done.stdout


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_what_could_not_be_written_is_told_by_the_code() -> None:
    body = "from flows.leaving import run_and_leave\nrun_and_leave(lambda: print('x' * 100))"
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONUNBUFFERED"}
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-c", body]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, env=environment)
    assert done.returncode == 120, done.stderr
