"""Files that appear whole: what killed writers leave, and what full disks are called."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gvr_core.atomic import atomic_write, why_not_written

WRITER = """
import sys, time
from pathlib import Path
from gvr_core.atomic import atomic_write
with atomic_write(Path(sys.argv[1])) as stream:
    stream.write(b"half")
    stream.flush()
    print("half", flush=True)
    time.sleep(600)
"""


def age(folder: Path) -> None:
    then = time.time() - 3600
    for path in folder.iterdir():
        os.utime(path, (then, then))


def test_a_killed_writer_leaves_a_file_that_the_next_one_takes_away(tmp_path: Path) -> None:
    path = tmp_path / "a[0].ply"  # also a pattern
    path.write_bytes(b"before")
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "half\n"
    age(tmp_path)
    with atomic_write(path) as stream:
        stream.write(b"whole")
    assert len(list(tmp_path.iterdir())) == 2  # old as it is, its writer lives
    process.send_signal(signal.SIGKILL)
    process.wait()
    with atomic_write(tmp_path / "b.ply") as stream:
        stream.write(b"another")
    assert len(list(tmp_path.iterdir())) == 3  # not a predecessor of this one
    with atomic_write(path) as stream:
        stream.write(b"again")
    assert sorted(item.name for item in tmp_path.iterdir()) == ["a[0].ply", "b.ply"]
    assert path.read_bytes() == b"again"


def test_a_young_file_is_left_to_its_writer(tmp_path: Path) -> None:
    young = tmp_path / f".x.{'0' * 32}.tmp"
    young.write_bytes(b"its writer is about to lock it")
    with atomic_write(tmp_path / "x") as stream:
        stream.write(b"whole")
    assert young.exists()


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "a.ply"),
        OSError(errno.EDQUOT, os.strerror(errno.EDQUOT)),
        ValueError("I/O error: No space left on device (os error 28)"),
    ],
)
def test_a_full_disk_is_named_with_the_room_left(error: Exception, tmp_path: Path) -> None:
    absent = tmp_path / "not" / "there"
    said = why_not_written(error, absent)
    assert said.startswith(f"no space left in {absent} (") and "bytes free" in said


def test_other_reasons_are_given_as_they_are(tmp_path: Path) -> None:
    assert why_not_written(PermissionError("no"), tmp_path) == "no"
