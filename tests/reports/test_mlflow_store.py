from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from reports.mlflow_store import (
    LocalStore,
    SyncError,
    begin_store,
    create_store,
    default_tracking_uri,
    local_store,
    locked,
    mlflow_client,
    sqlite_database,
)

FIRST_USE = """
import sys, time
from pathlib import Path
import mlflow.store.tracking.sqlalchemy_store
from reports.mlflow_store import create_store
me, database = sys.argv[1], Path(sys.argv[2])
(database.parent / me).touch()
while not all((database.parent / name).exists() for name in "ab"):
    time.sleep(0.005)
create_store(database)
"""


def test_two_first_users_at_once(tmp_path: Path) -> None:
    database = tmp_path / "mlflow.db"
    users = [
        subprocess.Popen([sys.executable, "-c", FIRST_USE, name, str(database)], stderr=-1)
        for name in "ab"
    ]
    for user in users:
        _, errors = user.communicate(timeout=120)
        assert user.returncode == 0, errors.decode()
    with mlflow_client(f"sqlite:///{database}") as client:
        run = client.create_run("0")
        client.log_metric(run.info.run_id, "a", 1.0)
        assert client.get_run(run.info.run_id).data.metrics == {"a": 1.0}


def test_a_store_begun_is_there_and_what_is_wrong_is_left_for_later(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "new")
    begin_store(store.uri)
    assert store.database.exists()
    with mlflow_client(store.uri) as client:
        client.create_run("0")
    begin_store(store.uri)
    with mlflow_client(store.uri) as client:
        assert len(client.search_runs(["0"])) == 1
    begin_store("sqlite://")  # names no file
    (tmp_path / "file").touch()
    begin_store(f"sqlite:///{tmp_path / 'file' / 'mlflow.db'}")


def test_creating_again_keeps_what_is_there(store: LocalStore) -> None:
    with mlflow_client(store.uri) as client:
        client.create_experiment("mine")
    create_store(store.database)
    with mlflow_client(store.uri) as client:
        assert client.get_experiment_by_name("mine") is not None


def test_nothing_lands_in_the_working_folder(store: LocalStore, tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    os.chdir(empty)
    with mlflow_client(store.uri) as client:
        client.log_text(client.create_run("0").info.run_id, "text", "a.txt")
    assert list(empty.iterdir()) == []


SPY = """
import os, sys
from reports.mlflow_store import mlflow_client

class Spy:
    def find_spec(self, name, path=None, target=None):
        if name == "mlflow":
            e = os.environ
            print("imported with", e.get("MLFLOW_DISABLE_TELEMETRY"), e.get("DO_NOT_TRACK"))

sys.meta_path.insert(0, Spy())
with mlflow_client(sys.argv[1]):
    pass
"""


def test_telemetry_is_off_before_mlflow_is_imported(store: LocalStore) -> None:
    done = subprocess.run(
        [sys.executable, "-c", SPY, store.uri], capture_output=True, text=True, check=True
    )
    assert done.stdout == "imported with true 1\n"


def test_limits_hold_inside_only_and_respect_the_user(
    store: LocalStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mlflow.environment_variables import (
        MLFLOW_HTTP_REQUEST_MAX_RETRIES,
        MLFLOW_HTTP_REQUEST_TIMEOUT,
    )

    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_TIMEOUT", "17")
    with mlflow_client(store.uri):
        assert MLFLOW_HTTP_REQUEST_MAX_RETRIES.get() == 1
        assert MLFLOW_HTTP_REQUEST_TIMEOUT.get() == 17
    assert "MLFLOW_HTTP_REQUEST_MAX_RETRIES" not in os.environ
    assert os.environ["MLFLOW_HTTP_REQUEST_TIMEOUT"] == "17"
    monkeypatch.delenv("MLFLOW_HTTP_REQUEST_TIMEOUT")
    with mlflow_client(store.uri):
        assert MLFLOW_HTTP_REQUEST_TIMEOUT.get() == 5


def test_where_the_store_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert local_store().database == tmp_path / ".gvr" / "mlflow" / "mlflow.db"
    monkeypatch.setenv("GVR_HOME", str(tmp_path / "elsewhere"))
    assert local_store().database == tmp_path / "elsewhere" / "mlflow" / "mlflow.db"
    assert default_tracking_uri() == local_store().uri
    assert sqlite_database(local_store().uri) == local_store().database
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://mine")
    assert default_tracking_uri() == "http://mine"
    assert sqlite_database("http://mine") is None


def test_a_file_that_is_no_database(tmp_path: Path) -> None:
    database = tmp_path / "mlflow.db"
    database.write_text("not a database, but long enough to look like one\n" * 50)
    with pytest.raises(SyncError, match="cannot be opened or created") as caught:
        create_store(database)
    assert caught.value.tracking_uri == f"sqlite:///{database}"
    assert database.read_text().startswith("not a database")


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(SyncError, match="cannot be opened or created"):
        create_store(tmp_path / "file" / "mlflow.db")


@pytest.mark.parametrize("uri", ["sqlite://", "sqlite:///:memory:", "sqlite:nonsense"])
def test_sqlite_without_a_file(uri: str) -> None:
    with pytest.raises(SyncError):
        sqlite_database(uri)


def test_a_dead_holder_frees_the_lock(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    code = (
        "import sys, time; from pathlib import Path; from reports.mlflow_store import locked\n"
        "with locked(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)\n"
    )
    holder = subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE)
    assert holder.stdout is not None
    assert holder.stdout.readline() == b"held\n"
    holder.kill()
    holder.wait()
    started = time.monotonic()
    with locked(path):
        assert time.monotonic() - started < 5
