"""Completion as a shell asks for it: through environment variables, in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from plugin_packages import install

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture
def work(tmp_path: Path) -> Path:
    """A folder with a suite file, a result, and a manifest of one's own."""
    (tmp_path / "mine.toml").write_text(
        'name = "mine"\n[[datasets]]\nname = "gallery"\nsettings = { seeds = [7] }\n'
    )
    (tmp_path / "notes.txt").touch()
    (tmp_path / "suites").mkdir()
    for run_id in ("20260101T000000Z-00000a", "20260102T000000Z-00000b"):
        (tmp_path / ".gvr/results" / run_id).mkdir(parents=True)
        (tmp_path / ".gvr/results" / run_id / "result.json").touch()
    return tmp_path


def gvr(work: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if not k.startswith("GVR_")}
    environment |= {"PYTHONPATH": str(REPOSITORY), "HOME": str(work)} | variables
    return subprocess.run(
        [sys.executable, "-m", "flows", *arguments],
        cwd=work,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )


def completed(work: Path, line: str, **variables: str) -> list[str]:
    """What bash would offer at the end of a line."""
    words = str(len(line.split(" ")) - 1)
    asked = gvr(work, COMP_WORDS=line, COMP_CWORD=words, _GVR_COMPLETE="complete_bash", **variables)
    assert asked.stderr == ""
    return asked.stdout.split()


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("gvr co", ["compare"]),
        ("gvr datasets e", ["export"]),
        ("gvr run --no", ["--no-mlflow"]),
        ("gvr run le", ["lerf_mask", "lerf_ovs"]),
        ("gvr run m", ["mine.toml"]),
        ("gvr run su", ["suites/"]),
        ("gvr schedule st", ["stress"]),
        ("gvr run bench --method gvr", ["gvr-paper", "gvr-robust"]),
        ("gvr run bench --models o", ["oracle", "onboard"]),
        ("gvr run bench --dataset lerf", ["lerf_ovs", "lerf_mask"]),
        ("gvr run mine.toml --scene ", ["gallery_7"]),
        ("gvr run --dataset gallery --scene gallery_2", ["gallery_2"]),
        ("gvr show 2026", ["20260102T000000Z-00000b", "20260101T000000Z-00000a"]),
        ("gvr compare 20260101T000000Z-00000a 20260102", ["20260102T000000Z-00000b"]),
        ("gvr models fetch sam:vit_b", ["sam:vit_b"]),
        ("gvr datasets export gal", ["gallery"]),
        ("gvr datasets export gallery gallery_3", ["gallery_3"]),
        ("gvr datasets check . --as na", ["native"]),
        ("gvr score --protocol lerf_ovs.o", ["lerf_ovs.opengaussian_3d/1"]),
        ("gvr cache ls --stage e", ["encode", "evaluate"]),
        ("gvr run --runner d", ["dask"]),
        ("gvr run nothing.toml --scene ", []),
    ],
)
def test_names_are_offered(work: Path, line: str, expected: list[str]) -> None:
    assert completed(work, line) == expected


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_each_shell_has_a_script(work: Path, shell: str) -> None:
    # As --show-completion prints it, which takes the shell from the processes above it.
    assert "_GVR_COMPLETE" in gvr(work, _GVR_COMPLETE=f"source_{shell}").stdout


def test_the_shell_that_asks_is_recognised(work: Path) -> None:
    asked = subprocess.run(
        ["bash", "-c", f"'{sys.executable}' -m flows --show-completion; exit $?"],
        cwd=work,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY), "HOME": str(work)},
        capture_output=True,
        text=True,
    )
    assert asked.returncode == 0, asked.stderr
    assert "_GVR_COMPLETE=complete_bash" in asked.stdout


def test_results_behind_a_url_are_not_waited_for(work: Path) -> None:
    asked = gvr(
        work,
        GVR_RESULTS="s3://nowhere/results",
        COMP_WORDS="gvr show 2026",
        COMP_CWORD="2",
        _GVR_COMPLETE="complete_bash",
    )
    assert asked.stdout.split() == []


def test_names_of_plugins_are_offered(work: Path) -> None:
    offers = {
        "gvr_bench.methods": {"nearest": "parts:make"},
        "gvr_bench.datasets": {"near": "parts:make"},
    }
    install(work / "installed", "near-parts", "1.0", offers, {})
    path = os.pathsep.join([str(REPOSITORY), str(work / "installed")])
    assert completed(work, "gvr run bench --method ne", PYTHONPATH=path) == ["nearest"]
    assert completed(work, "gvr run bench --dataset ne", PYTHONPATH=path) == ["near"]
