"""What commands say: one JSON document for scripts, tables that fit 80 columns for people."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_calls import CALLS, Project, made_project

from flows.lessons import LESSONS

REPOSITORY = Path(__file__).resolve().parents[2]
DOCS = REPOSITORY / "docs" / "command_line.md"
SERVERS = {"view", "ui", "schedule"}
"""Commands that serve until they are interrupted, and so have no document."""
GROUPS = {"cache", "models", "datasets"}

TABLES = {
    *("doctor", "run", "run --dry-run", "ground", "ls", "show", "compare", "score"),
    *("cache ls", "models ls"),
}
PRECIOUS = {
    "run --dry-run": ("8 of 8", "two-boxes"),
    "ls": ("FIRST", "small"),
    "cache ls": ("evaluate", "MB"),
    "models ls": ("grounded_sam:swin_b", "938 MB", "Apache-2.0"),
    "doctor": ("renderer",),
}
"""Document -> what its table must not lose."""


@pytest.fixture(scope="module")
def project(
    tmp_path_factory: pytest.TempPathFactory, two_boxes_folder: Path, prefect_server: object
) -> Iterator[Project]:
    """A project that one small run was made in."""
    with made_project(tmp_path_factory.mktemp("project"), two_boxes_folder) as made:
        yield made


@pytest.fixture(scope="module")
def documents(project: Project) -> dict[str, dict[str, Any]]:
    """What every command says with ``--json``, as it is asked for."""
    return {}


def document(project: Project, known: dict[str, dict[str, Any]], name: str) -> dict[str, Any]:
    if name not in known:
        said = project.call(*CALLS[name], "--json")
        assert said.code == 0, said.err
        known[name] = json.loads(said.out)
    return known[name]


def documented() -> dict[str, list[str]]:
    """Document -> its fields, from the table of docs/command_line.md."""
    rows = re.findall(r"^\| `([a-z -]+)` \| (.+) \|$", DOCS.read_text(), re.MULTILINE)
    return {name: re.findall(r"`([a-z_]+)`", fields) for name, fields in rows}


def test_every_command_that_is_no_server_has_a_document() -> None:
    assert set(CALLS) - {"run --dry-run"} == set(LESSONS) - SERVERS - GROUPS


@pytest.mark.parametrize("name", CALLS)
def test_one_document_and_nothing_else(project: Project, documents, name: str) -> None:
    found = document(project, documents, name)
    assert list(found)[:2] == ["document", "version"]
    assert (found["document"], found["version"]) == (name, 1)


@pytest.mark.parametrize("name", CALLS)
def test_documents_are_documented(project: Project, documents, name: str) -> None:
    assert documented()[name] == list(document(project, documents, name))[2:]


@pytest.mark.parametrize("name", CALLS)
def test_people_get_lines_that_are_not_cut(project: Project, name: str) -> None:
    said = project.call(*CALLS[name])
    assert said.code == 0, said.err
    assert said.out and "…" not in said.out
    if name in TABLES:  # sentences are left to the terminal, so that a path in one stays whole
        for line in said.out.splitlines():
            assert len(line.rstrip()) <= 80, line
    for text in PRECIOUS.get(name, ()):
        assert {"FIRST": project.first}.get(text, text) in said.out


def test_numbers_of_a_result(project: Project, documents) -> None:
    found = document(project, documents, "show")
    numbers = {(n["method"], n["title"], n["scene"]): n["value"] for n in found["numbers"]}
    assert {method for method, _, _ in numbers} == {"gvr-paper", "gvr-robust"}
    for scene in ("two-boxes", None):
        for title in ("Acc", "mIoU", "3D IoU"):
            assert 0 <= numbers["gvr-paper", title, scene] <= 1
    (paper, _) = found["scenes"]
    assert next(iter(paper["stages"])) == "render"
    assert set(paper["stages"].values()) <= {"cached", "computed"}
    assert all(answer["text"] for answer in paper["answers"])


def test_numbers_are_those_of_the_table(project: Project) -> None:
    found = json.loads(project.call("show", project.first, "--json").out)
    value = next(
        n["value"]
        for n in found["numbers"]
        if (n["method"], n["title"], n["scene"]) == ("gvr-paper", "mIoU", None)
    )
    table = project.call("show", project.first, "--markdown").out
    row = next(line for line in table.splitlines() if line.startswith("| gvr-paper | "))
    assert f"{100 * value:.1f}" in row.split("|")[-2].split("/")[1]


def test_a_dry_run_knows_what_is_cached(project: Project, documents) -> None:
    found = document(project, documents, "run --dry-run")
    assert found["to_compute"] == 0
    assert {line["line"] for line in found["lines"]} == {"gvr-paper", "gvr-robust"}
    assert set(found["lines"][0]["stages"].values()) == {"cached"}


@pytest.mark.parametrize(
    "arguments",
    [
        ("show", "2026"),
        ("run", "smal.toml"),
        ("compare", "FIRST", "nothing"),
        ("cache", "push"),
        ("datasets", "check", "nowhere"),
        ("show", "--markdown"),
    ],
)
def test_errors_stay_one_line_and_keep_their_code(project: Project, arguments) -> None:
    plain, scripted = project.call(*arguments), project.call(*arguments, "--json")
    if arguments == ("show", "--markdown"):
        assert scripted.code == 2 and "both --markdown and --json" in scripted.err
        plain = scripted
    assert (scripted.code, scripted.err) == (plain.code, plain.err)
    assert scripted.code in (1, 2) and scripted.out == ""
    assert scripted.err.startswith("gvr: ") and len(scripted.err.splitlines()) == 1


def test_a_failed_scene_is_in_the_document_and_in_the_exit_code(project: Project) -> None:
    broken = project.folder / "broken" / "one"
    broken.mkdir(parents=True, exist_ok=True)
    (broken / "scene.json").write_text("{")
    (project.folder / "broken.toml").write_text(
        'name = "broken"\n[[datasets]]\nname = "folder:broken"\n'
    )
    said = project.call("run", "broken.toml", "--quiet", "--no-mlflow", "--json")
    assert said.code == 2
    found = json.loads(said.out)
    assert found["status"] == "failed" and "scene.json" in found["scenes"][0]["error"]
    assert "failed: folder:broken/one" in said.err


def test_a_check_with_something_wrong_is_still_a_document(project: Project) -> None:
    broken = project.folder / "half" / "one"
    broken.mkdir(parents=True, exist_ok=True)
    (broken / "scene.json").write_text("{")
    said = project.call("datasets", "check", "half", "--json")
    assert said.code == 2
    (scene,) = json.loads(said.out)["scenes"]
    assert scene["error"] and scene["gaussians"] is None


def test_a_process_of_its_own_prints_nothing_but_the_document(project: Project) -> None:
    # Its Prefect and MLflow are real and start in it; what they log goes elsewhere.
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("GVR_", "PREFECT_"))}
    done = subprocess.run(
        [sys.executable, "-m", "flows", "run", "small.toml", "--json"],
        cwd=project.folder,
        env=environment | {"PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        check=True,
    )
    found = json.loads(done.stdout)
    assert found["status"] == "completed" and "runs" in found["mlflow"]
