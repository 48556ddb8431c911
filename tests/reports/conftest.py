"""A small result, MLflow stores that are quick to make, and one MLflow server a session."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from killable_server import Server
from record_samples import Sample, make_sample

from reports.mlflow_store import LocalStore, create_store
from reports.result_io import write_result


@pytest.fixture
def sample() -> Sample:
    return make_sample()


@pytest.fixture
def result_folder(sample: Sample, tmp_path: Path) -> Path:
    result, rows, pictures = sample
    return write_result(tmp_path / "results" / result.run_id, result, rows, pictures)


@pytest.fixture(autouse=True)
def _own_settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No test writes to the working folder, or to an MLflow that the user has."""
    monkeypatch.chdir(tmp_path)
    for name in [name for name in os.environ if name.startswith(("MLFLOW_", "GVR_"))]:
        monkeypatch.delenv(name)


@pytest.fixture(scope="session")
def _empty_database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    database = tmp_path_factory.mktemp("empty") / "mlflow.db"
    create_store(database)
    return database


@pytest.fixture
def store(_empty_database: Path, tmp_path: Path) -> LocalStore:
    """A store with its tables; a copy, as the migrations take seconds."""
    made = LocalStore(tmp_path / "mlflow home")
    made.folder.mkdir()
    shutil.copy(_empty_database, made.database)
    return made


@pytest.fixture(scope="session")
def _server(_empty_database: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    store = LocalStore(tmp_path_factory.mktemp("served"))
    shutil.copy(_empty_database, store.database)
    server = Server(store)
    yield server
    server.stop()


@pytest.fixture
def server(_server: Server) -> Server:
    _server.start()
    return _server
