from __future__ import annotations

import subprocess
from importlib import metadata
from pathlib import Path

import pytest

from reports.environment import PACKAGES, describe_environment


def git(folder: Path, *arguments: str) -> str:
    names = ["-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false"]
    done = subprocess.run(
        ["git", "-C", str(folder), *names, *arguments], check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    folder = tmp_path / "checkout"
    folder.mkdir()
    git(folder, "init", "-q")
    (folder / "a.txt").write_text("a")
    git(folder, "add", "a.txt")
    git(folder, "commit", "-q", "-m", "first")
    return folder


def test_revision_and_changes(checkout: Path) -> None:
    clean = describe_environment(checkout)
    assert clean.git_revision == git(checkout, "rev-parse", "HEAD")
    assert clean.git_dirty is False
    (checkout / "a.txt").write_text("b")
    assert describe_environment(checkout).git_dirty is True
    git(checkout, "checkout", "-q", "a.txt")
    (checkout / "new.py").write_text("")
    assert describe_environment(checkout).git_dirty is True


def test_folder_inside_another_repository_has_no_revision(checkout: Path) -> None:
    inner = checkout / "site-packages"
    inner.mkdir()
    environment = describe_environment(inner)
    assert (environment.git_revision, environment.git_dirty) == (None, None)


def test_repository_without_commits(tmp_path: Path) -> None:
    git(tmp_path, "init", "-q")
    assert describe_environment(tmp_path).git_revision is None


def test_without_git(checkout: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    environment = describe_environment(checkout)
    assert (environment.git_revision, environment.git_dirty) == (None, None)


def test_versions_are_the_installed_ones() -> None:
    environment = describe_environment()
    assert environment.packages["numpy"] == metadata.version("numpy")
    assert environment.packages["mlflow"] == metadata.version("mlflow")
    assert set(environment.packages) <= set(PACKAGES)
    assert environment.cpu_count >= 1
    assert environment.processor
