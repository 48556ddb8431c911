"""The checks find what they are there to find."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from faults.checks import litter
from faults.full_disk import message_losses
from faults.lines import Line, markdown
from faults.work import difference
from tasks.store import Store

REPOSITORY = Path(__file__).resolve().parents[2]

CARELESS = """
import sys
from pathlib import Path
import faults.work
from faults.kills import again, kill_at_points, write_points
from faults.lines import Line
from faults.work import comparable, make_work

def careless(folder, result, rows, pictures):
    # Test double: a writer of results that does not care what a kill leaves.
    folder.mkdir(parents=True)
    (folder / "result.json").write_text(result.model_dump_json())
    (folder / "rows.jsonl").write_text("")
    return folder

faults.work.write_result = careless
folder = Path(sys.argv[1])
work = make_work(folder)
reference = comparable(again(work, folder / "store", folder / "results"))
names = write_points(work, folder)
line = Line("points", "careless")
halves = [point for point, name in enumerate(names, 1) if name == "half of .jsonl"]
kill_at_points(work, folder, reference, names, halves, line)
print(line.tried, line.survived, *line.losses)
"""


def test_a_writer_that_leaves_half_a_result_is_found(tmp_path: Path) -> None:
    tests = REPOSITORY / "tests"
    done = subprocess.run(
        [sys.executable, "-c", CARELESS, str(tmp_path)],
        cwd=REPOSITORY,
        env={"PYTHONPATH": f"{REPOSITORY}:{tests}", "HOME": str(tmp_path), "PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.stdout.startswith("1 0 "), done.stderr
    assert "a half-written result is listed" in done.stdout


def test_unfinished_files_that_stay_are_found(tmp_path: Path) -> None:
    left = tmp_path / "results" / ".r.0123.tmp"
    left.mkdir(parents=True)
    assert litter(tmp_path / "store", tmp_path / "results") == [".r.0123.tmp stays for ever"]
    store = Store(tmp_path / "store")
    store.put_bytes("text", b"text")
    (store.temporary / "unfinished").write_bytes(b"half")
    left.rmdir()
    assert litter(tmp_path / "store", tmp_path / "results") == []  # gc took it


@pytest.mark.parametrize(
    ("output", "finding"),
    [
        ("Traceback (most recent call last)\nOSError", "a traceback"),
        ("gvr: something went wrong", "no word of it"),
        ("gvr: no space left on the moon (0 bytes free)", "neither place"),
    ],
)
def test_a_poor_message_about_a_full_disk_is_found(output: str, finding: str) -> None:
    (loss,) = message_losses(output, Path("/disk"))
    assert loss.startswith(finding)
    assert message_losses("gvr: no space left in /disk (0 bytes free)", Path("/disk")) == []


def test_another_result_is_found() -> None:
    one = {"files": {"rows.jsonl": "a"}, "result": {}}
    assert difference(one, one) is None
    assert difference(one, {**one, "files": {"rows.jsonl": "b"}}) == "rows.jsonl differs"
    assert difference(one, {**one, "result": {"suite": "x"}}) == "result.json differs"


def test_what_was_lost_is_counted() -> None:
    line = Line("points", "a kill")
    line.add([])
    line.add(["a row"], "point 3")
    assert (line.tried, line.survived, line.lost, line.losses) == (2, 1, 1, ["point 3: a row"])
    assert "| a kill | 2 | 1 | 1 |" in markdown([line], "python x.py")
