"""MLflow is made ready beside other work."""

from __future__ import annotations

import sqlite3
import threading
from pathlib import Path

import pytest

from reports import mlflow_ahead
from reports.mlflow_ahead import mlflow_ready


def test_a_store_is_there_at_the_end_of_the_block(tmp_path: Path) -> None:
    database = tmp_path / "mlflow.db"
    before = threading.active_count()
    with mlflow_ready(f"sqlite:///{database}"):
        pass
    with sqlite3.connect(database) as connection:
        names = {row[0] for row in connection.execute("SELECT name FROM sqlite_master")}
    assert {"experiments", "runs", "metrics"} <= names
    assert threading.active_count() == before


def test_the_block_runs_meanwhile(monkeypatch: pytest.MonkeyPatch) -> None:
    inside, came = threading.Event(), []
    monkeypatch.setattr(mlflow_ahead, "make_ready", lambda uri: came.append(inside.wait(30)))
    with mlflow_ready("sqlite:///unused.db"):
        inside.set()
    assert came == [True]


def test_nothing_is_started_without_mlflow() -> None:
    before = threading.active_count()
    with mlflow_ready(None):
        assert threading.active_count() == before


def test_a_store_that_cannot_be_made_does_not_stop_the_run(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("in the way")
    done = []
    with mlflow_ready(f"sqlite:///{file}/mlflow.db"):
        done.append(True)
    assert done == [True]
    assert file.read_text() == "in the way"


def test_an_error_of_the_block_is_passed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    came: list[str] = []
    monkeypatch.setattr(mlflow_ahead, "make_ready", came.append)
    with pytest.raises(KeyError, match="of the block"), mlflow_ready("sqlite:///unused.db"):
        raise KeyError("of the block")
    assert came == ["sqlite:///unused.db"]
