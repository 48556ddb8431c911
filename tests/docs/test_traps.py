"""The page of traps: every trap says what to do, and the tests that it names exist."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest
from docs_pages import DOCS

from flows import doctor

PAGE = (DOCS / "traps.md").read_text(encoding="utf-8")
TRAPS = {part.splitlines()[0]: part for part in PAGE.split("\n### ")[1:]}
NAMED = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", PAGE)


@cache
def names_in(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("trap", TRAPS)
def test_a_trap_says_what_is_seen_why_and_what_to_do(trap: str) -> None:
    lines = re.findall(r"^- \*\*(.+?):\*\*", TRAPS[trap], re.MULTILINE)
    assert lines == ["Seen", "Cause", "Do", "Shown by"]
    assert "`tests/" in TRAPS[trap] or "no test." in TRAPS[trap]


def test_the_named_tests_exist() -> None:
    assert len(NAMED) > 50
    assert len(NAMED) == PAGE.count("`tests/") - 1  # the page names this file
    missing = [
        f"{path}::{name}" for path, name in NAMED if name not in names_in(DOCS.parent / path)
    ]
    assert not missing


def test_the_doctor_looks_at_the_versions_that_fail_silently(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert doctor._known_trouble()[0] == "ok"
    for package, bad in {"fastapi": "0.155.0", "sqlalchemy": "2.1.0"}.items():
        versions = {"fastapi": "0.150.0", "sqlalchemy": "2.0.40", "transformers": "4.57.6"}
        versions[package] = bad
        monkeypatch.setattr(doctor.importlib.metadata, "version", versions.__getitem__)
        state, text = doctor._known_trouble()
        assert state == "bad"
        assert f"{package} {bad} (needs <" in text
