from __future__ import annotations

import os
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import psutil
import pytest
from prefect import flow
from prefect.settings import get_current_settings

from tasks.prefect_runtime import PrefectRuntime, prefect_runtime, user_has_prefect
from tasks.prefect_server import _is_free, read_record
from tasks.store import Store

VARIABLES = ("PREFECT_API_URL", "PREFECT_PROFILE", "PREFECT_HOME", "PREFECT_PROFILES_PATH")


def clean_environment(home: Path, **more: str) -> dict[str, str]:
    """This process's environment as that of a user who never used Prefect, with ``more``."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith("PREFECT")}
    kept.pop("DO_NOT_TRACK", None)
    return kept | {"HOME": str(home)} | more


@pytest.mark.parametrize("name", VARIABLES)
def test_user_with_a_prefect_of_their_own_is_recognised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for variable in VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    assert not user_has_prefect()
    monkeypatch.setenv(name, "something")
    assert user_has_prefect()
    monkeypatch.delenv(name)
    (tmp_path / ".prefect").mkdir()
    (tmp_path / ".prefect" / "profiles.toml").touch()
    assert user_has_prefect()


def test_settings_inside(prefect_server: PrefectRuntime, tmp_path: Path) -> None:
    before = get_current_settings().results.local_storage_path
    store = Store(tmp_path / "store")
    with prefect_runtime(store) as runtime:
        settings = get_current_settings()
        assert settings.flows.heartbeat_frequency is None
        assert settings.results.local_storage_path == store.root / "prefect-results"
        assert settings.results.default_serializer == "json"
        assert settings.server.analytics_enabled is False
        assert settings.server.services.event_persister.enabled is False
        assert settings.server.services.task_run_recorder.batch_size == 100
        assert settings.server.ephemeral.startup_timeout_seconds == 120
        assert settings.home == runtime.home == prefect_server.home
        assert (os.environ["DO_NOT_TRACK"], os.environ["PREFECT_API_URL"]) == ("1", runtime.api_url)
    assert get_current_settings().results.local_storage_path == before


def test_a_block_inside_another_uses_its_server(
    prefect_server: PrefectRuntime, tmp_path: Path
) -> None:
    with prefect_runtime(Store(tmp_path / "store"), home=tmp_path / "unused") as inner:
        assert inner.api_url == prefect_server.api_url and not inner.own_server
        assert inner.own_home and inner.home == prefect_server.home
    assert not (tmp_path / "unused").exists()
    assert os.environ["PREFECT_API_URL"] == prefect_server.api_url

    @flow
    def alive() -> int:
        return 3

    assert alive() == 3


def test_server_is_on_loopback_and_reports_to_nobody(prefect_server: PrefectRuntime) -> None:
    assert prefect_server.own_server and prefect_server.api_url.startswith("http://127.0.0.1:")
    record = read_record(prefect_server.home)
    assert record is not None and record.url == prefect_server.api_url
    server = record.process()
    assert server is not None
    environment = server.environ()
    assert environment["PREFECT_SERVER_ANALYTICS_ENABLED"].lower() == "false"
    assert environment["DO_NOT_TRACK"] == "1"
    assert environment["PREFECT_HOME"] == str(prefect_server.home)
    listening = [each for each in server.net_connections() if each.status == psutil.CONN_LISTEN]
    assert {each.laddr.ip for each in listening} == {"127.0.0.1"}


def test_server_that_does_not_start_is_an_error_that_says_so(tmp_path: Path) -> None:
    (tmp_path / "prefect.db").write_text("no database\n" * 1000)
    code = (
        "from tasks.prefect_runtime import prefect_runtime\n"
        "from tasks.store import Store\n"
        f"with prefect_runtime(Store(), home={str(tmp_path)!r}, isolated=True): print('in')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=clean_environment(tmp_path),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1 and done.stdout == ""
    last = done.stderr.strip().splitlines()[-1]
    assert "StoreError: no Prefect server could be started with home" in done.stderr
    assert "not a database" in done.stderr and str(tmp_path / "server.log") in last
    assert _is_free(tmp_path / "users.lock") and read_record(tmp_path).process() is None


USERS_OWN = """
from tasks.prefect_runtime import prefect_runtime
from tasks.store import Store
with prefect_runtime(Store()) as runtime:
    from prefect.settings import get_current_settings
    settings = get_current_settings()
    print(runtime.api_url, runtime.own_home, runtime.own_server, runtime.home)
    print(settings.flows.heartbeat_frequency, settings.results.local_storage_path)
    print(settings.logging.level)
"""


def test_users_own_server_and_home_are_kept(tmp_path: Path) -> None:
    url, home = "http://127.0.0.1:9/api", tmp_path / "theirs"
    done = subprocess.run(
        [sys.executable, "-c", USERS_OWN],
        cwd=tmp_path,
        env=clean_environment(
            tmp_path, PREFECT_API_URL=url, PREFECT_HOME=str(home), PREFECT_LOGGING_LEVEL="DEBUG"
        ),
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines() == [
        f"{url} False False {home}",
        f"None {tmp_path}/.gvr/store/prefect-results",
        "DEBUG",
    ]
    assert not (tmp_path / ".gvr").exists() and not (tmp_path / ".prefect").exists()


FIRST_USE = """
from tasks.prefect_runtime import prefect_runtime
from tasks.stage import Stage, run_stage
from tasks.store import Store

def number(store, inputs, config):
    return {"n": store.put_json("n", 1)}

with prefect_runtime(Store()) as runtime:
    from prefect import flow

    @flow
    def seven():
        return [run_stage(Stage(f"s{i}", 1, number), Store(), {}, {}).state for i in range(7)]

    print(set(seven()), runtime.own_home, runtime.own_server)
"""


@pytest.mark.slow
def test_first_use_in_a_fresh_project_and_the_next(tmp_path: Path) -> None:
    for expected in ("Completed", "Cached"):
        done = subprocess.run(
            [sys.executable, "-c", FIRST_USE],
            cwd=tmp_path,
            env=clean_environment(tmp_path),
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout == f"{{'{expected}'}} True True\n"
        assert "ERROR" not in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / ".prefect").exists()
    with closing(sqlite3.connect(tmp_path / ".gvr" / "prefect" / "prefect.db")) as database:
        shown = database.execute("select state_name, count(*) from task_run group by 1").fetchall()
    assert sorted(shown) == [("Cached", 7), ("Completed", 7)]  # the last states too
