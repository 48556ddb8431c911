"""Fixtures that every test folder shares."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest
from plugin_packages import as_in_a_new_process
from s3_server import S3Server

from tasks.prefect_runtime import PrefectRuntime, prefect_runtime
from tasks.store import Store

REPOSITORY = Path(__file__).resolve().parent.parent
sys.path.append(str(REPOSITORY / "benchmarks"))  # scripts, which tests import parts of


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with real splats, photographs and a small SAM; tests skip where it is absent."""
    folder = Path(os.environ.get("GVR_SHARED", REPOSITORY.parent / "shared"))
    if not (folder / "data" / "splats").is_dir():
        pytest.skip(f"no shared data at {folder} (set GVR_SHARED)")
    return folder


@pytest.fixture(scope="session")
def prefect_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PrefectRuntime]:
    """One Prefect server on 127.0.0.1 for all tests, with a home of its own."""
    folder = tmp_path_factory.mktemp("prefect")
    with prefect_runtime(Store(folder / "store"), home=folder / "home", isolated=True) as runtime:
        yield runtime


@pytest.fixture(scope="session")
def s3_server() -> Iterator[S3Server]:
    """One S3 server on 127.0.0.1 for all tests."""
    server = S3Server()
    yield server
    server.kill()


@pytest.fixture
def s3(s3_server: S3Server, monkeypatch: pytest.MonkeyPatch) -> S3Server:
    """The S3 server, as the one that s3:// means in this test."""
    monkeypatch.setitem(fsspec.config.conf, "s3", s3_server.settings)
    return s3_server


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of installed packages that this process finds, empty at first."""
    folder = tmp_path / "packages"
    folder.mkdir()
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # a second's edits would not be seen
    monkeypatch.syspath_prepend(str(folder))
    as_in_a_new_process(folder)
    yield folder
    as_in_a_new_process(folder)
