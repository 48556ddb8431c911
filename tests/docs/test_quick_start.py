"""The quick start, run as it stands there."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from docs_pages import blocks
from fresh_folder import REPOSITORY, shell

from gvr_core.splat_io import read_ply

PAGE = "quick_start.md"
NUMBER = re.compile(r"[-+]?\d[\d.,]*(e[-+]?\d+)?")


def shape(line: str) -> str:
    """A line's words, with every number as #."""
    return " ".join(NUMBER.sub("#", line).split())


def test_installing_is_a_target_of_the_makefile() -> None:
    first, second = blocks(PAGE, "sh")["install"].splitlines()
    dry = ["make", "--dry-run", "--always-make", *first.split()[1:]]
    said = subprocess.run(dry, cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout
    assert first.startswith("make ")
    assert "pip install" in said
    assert second == ". .venv/bin/activate"


def test_every_output_belongs_to_a_block() -> None:
    assert set(blocks(PAGE, "text")) == set(blocks(PAGE, "sh")) - {"install"}


@pytest.mark.slow
def test_the_blocks_run_in_an_empty_folder(tmp_path: Path) -> None:
    commands, promised = blocks(PAGE, "sh"), blocks(PAGE, "text")
    del commands["install"]
    for name, block in commands.items():
        printed = [shape(line) for line in shell(block, tmp_path).splitlines()]
        for line in promised[name].splitlines():
            assert shape(line) in printed, (name, line, printed)

    assert "| gvr-paper |" in (tmp_path / "tables.md").read_text()
    assert (tmp_path / "report.html").read_text().lower().startswith("<!doctype html>")
    (answer,) = json.loads((tmp_path / "found" / "answers.json").read_text())["answers"]
    rows = np.load(tmp_path / "found" / answer["files"]["indices"])
    scene = tmp_path / ".gvr/data/gallery/gallery_0/point_cloud/iteration_30000/point_cloud.ply"
    target = read_ply(tmp_path / "found" / "q0.target.ply")
    assert np.array_equal(target.means, read_ply(scene).means[rows])
    assert {path.name for path in (tmp_path / "found").iterdir()} == {
        "answers.json",
        *answer["files"].values(),
    }
