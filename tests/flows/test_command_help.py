"""Help that teaches: examples that parse, what comes next, one-line errors, and a page for all."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from flows.cli import app
from flows.lessons import FIRST, HERE, LESSONS, RESULTS, RUN

REPOSITORY = Path(__file__).resolve().parents[2]
DOCS = REPOSITORY / "docs" / "command_line.md"
PAGES = (REPOSITORY / "README.md", *sorted(DOCS.parent.glob("*.md")))


def tree(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Every command with its name, groups too."""
    for name, inner in getattr(command, "commands", {}).items():
        yield " ".join((*path, name)), inner
        yield from tree(inner, (*path, name))


COMMANDS = dict(tree(typer.main.get_command(app)))


def parse(line: str) -> None:
    """Parse a command line as `gvr` would, and run nothing.

    A comment ends it, and ``> FILE`` behind it is the shell's.
    """
    words = shlex.split(line.partition(" > ")[0], comments=True)
    assert words.pop(0).rpartition("/")[2] == "gvr"
    command: Any = typer.main.get_command(app)
    while hasattr(command, "commands") and words and not words[0].startswith("-"):
        assert words[0] in command.commands, line
        command = command.commands[words.pop(0)]
    if words[-1:] == ["--help"] or hasattr(command, "commands"):
        options = {option for parameter in command.params for option in parameter.opts}
        assert set(words) <= {"--help", *options}, line
        return
    command.make_context("gvr", words)


def shown_commands(page: Path) -> list[str]:
    """The lines of a page's code blocks that call gvr, continued ones as one."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
    lines = re.split(r"\n| && ", "\n".join(blocks).replace("\\\n", " "))
    return [line for line in lines if re.match(r"([\w./-]*/)?gvr ", line)]


def test_every_command_has_a_lesson() -> None:
    assert set(COMMANDS) == set(LESSONS)


@pytest.mark.parametrize("name", LESSONS)
def test_help_has_a_purpose_examples_and_what_comes_next(gvr, monkeypatch, name: str) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    code, out, err = gvr(*name.split(), "--help")
    assert (code, err) == (0, "")
    assert max(len(line.rstrip()) for line in out.splitlines()) <= 80
    flat = " ".join(out.split())
    purpose = (COMMANDS[name].help or "").strip().splitlines()[0]
    assert purpose[-1] in ".?" and purpose in flat
    for example in LESSONS[name].examples:
        assert f"$ {example}" in flat
    assert f"Next: {LESSONS[name].next}" in flat


@pytest.mark.parametrize("line", [line for lesson in LESSONS.values() for line in lesson.examples])
def test_examples_parse(line: str) -> None:
    parse(line)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_on_pages_parse(page: Path) -> None:
    for line in shown_commands(page):
        parse(line)


def test_the_page_has_every_command_with_an_example_that_parses() -> None:
    rows = re.findall(
        r"^\| `gvr ([a-z ]+)` \| .+ \| `(gvr .+)` \|$", DOCS.read_text(), re.MULTILINE
    )
    examples = dict(rows)
    groups = {name for name in COMMANDS if hasattr(COMMANDS[name], "commands")}
    assert list(examples) == [name for name in LESSONS if name not in groups]
    for name, example in examples.items():
        assert example.startswith(f"gvr {name}")
        parse(example)


def test_commands_are_listed_by_what_they_are_for(gvr) -> None:
    code, out, _ = gvr("--help")
    assert code == 0
    places = [out.index(f" {panel} ") for panel in (FIRST, RUN, RESULTS, HERE)]
    assert places == sorted(places)
    assert places[0] < out.index(" init ") < out.index(" run ") < places[1]
    assert "docs/command_line.md" in out


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("rum",), "No such command 'rum'. Did you mean 'run'? (see: gvr --help)"),
        (("run", "--limt", "3"), "(see: gvr run --help)"),
        (("run", "--limit", "three"), "(see: gvr run --help)"),
        (("compare", "one"), "(see: gvr compare --help)"),
        (("cache", "lst"), "(see: gvr cache --help)"),
    ],
)
def test_a_wrong_command_line_is_one_line_with_the_way_on(gvr, arguments, expected) -> None:
    code, out, err = gvr(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("gvr: ") and err.rstrip().endswith(expected)
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("run", "bnech"), "unknown suite 'bnech'; did you mean 'bench'?"),
        (("run", "mine"), "unknown suite 'mine'; did you mean 'mine.toml'?"),
        (("run", "mime.toml"), "did you mean 'mine.toml'? (accepted: a TOML file; `gvr init"),
        (("run", "--method", "gvr-rubost"), "did you mean 'gvr-robust'?"),
        (("run", "--scene", "galery_0"), "did you mean 'gallery_0'?"),
        (("run", "--models", "onbord"), "did you mean 'onboard'?"),
        (("show", "20260101T000000Z-00000b"), "did you mean '20260101T000000Z-00000a'?"),
        (("show", "elsewhere"), "(accepted: 20260101T000000Z-00000a, which `gvr ls` lists"),
        (("models", "fetch", "sam:vit_n"), "did you mean 'sam:vit_"),
        (("datasets", "export", "galery", "x"), "did you mean 'gallery'?"),
        (
            ("score", "--protocol", "lerf_ovs.opengausian_3d"),
            "did you mean 'lerf_ovs.opengaussian_3d",
        ),
        (("view", "gallery/galery_1"), "did you mean 'gallery_1'?"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else None,
)
def test_near_misses_are_asked_for(gvr, home, tmp_path, monkeypatch, arguments, expected) -> None:
    from report_samples import written

    written(home / "results", n_queries=2, run_id="20260101T000000Z-00000a")
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").touch()
    code, out, err = gvr(*arguments)
    assert (code, out) == (2, "")
    assert expected in err and len(err.splitlines()) == 1


def test_without_a_result_the_next_step_is_a_run(gvr, home) -> None:
    code, _, err = gvr("report")
    assert code == 2 and "no results yet (accepted: `gvr run` makes one)" in err
    code, out, _ = gvr("ls")
    assert code == 0 and out.splitlines()[-1] == "Next: gvr run bench"


def test_ctrl_c_has_the_shells_exit_code(gvr, home, monkeypatch) -> None:
    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("flows.results_commands.list_results", interrupted)  # a test double
    code, out, err = gvr("ls")
    assert (code, out) == (130, "") and "Traceback" not in err


def test_help_and_completion_load_nothing_that_computes() -> None:
    code = (
        "import sys, flows.cli; "
        "print(sorted(set(sys.modules) & {'numpy', 'torch', 'numba', 'prefect', 'mlflow'}))"
    )
    output = subprocess.run(
        [sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=True
    ).stdout
    assert output.strip() == "[]"
