"""Imports point down: flows -> tasks -> (datasets, reports) -> gvr_core."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
OURS = {"flows", "tasks", "datasets", "reports", "gvr_core"}
MAY_IMPORT = {
    "gvr_core": {"gvr_core"},
    "datasets": {"datasets", "gvr_core"},
    "reports": {"reports", "gvr_core"},
    "tasks": {"tasks", "datasets", "reports", "gvr_core"},
    "flows": OURS,
}


def imported_packages(path: Path) -> set[str]:
    """Top-level packages that a file imports anywhere, inside functions too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module.split(".")[0])
    return names


@pytest.mark.parametrize("package", sorted(MAY_IMPORT))
def test_imports_point_down(package: str) -> None:
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    for path in files:
        upward = (imported_packages(path) & OURS) - MAY_IMPORT[package]
        assert not upward, f"{path.relative_to(ROOT)} imports {', '.join(sorted(upward))}"


def test_the_core_knows_neither_prefect_nor_mlflow() -> None:
    for path in (ROOT / "gvr_core").rglob("*.py"):
        assert not imported_packages(path) & {"prefect", "mlflow"}, path


def test_using_the_core_loads_neither_prefect_nor_mlflow() -> None:
    code = (
        "import sys, gvr_core.methods, gvr_core.models.registry, gvr_core.rendering, "
        "gvr_core.splat_io; "
        "print(sorted(set(sys.modules) & {'prefect', 'mlflow', 'flows', 'tasks', 'reports'}))"
    )
    output = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert output.strip() == "[]"
