from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any
from urllib.request import ProxyHandler, build_opener

import pytest
from killable_server import Server
from mlflow import MlflowClient
from mlflow.entities import ViewType
from mlflow_contents import everything, forget_whole, nameless, runs_of
from record_samples import make_sample

from reports.mlflow_sink import WHOLE_TAG, sync
from reports.mlflow_store import LocalStore, SyncError, mlflow_client
from reports.result_check import ResultError
from reports.result_io import write_result


def test_again_changes_nothing(result_folder: Path, store: LocalStore) -> None:
    sync(result_folder, store.uri)
    before = everything(store)
    again = sync(result_folder, store.uri)
    assert (again.n_created, again.n_continued, again.n_unchanged) == (0, 0, 5)
    assert everything(store) == before
    assert forget_whole(store.uri) == 5
    rewritten = sync(result_folder, store.uri)
    assert (rewritten.n_created, rewritten.n_continued, rewritten.n_unchanged) == (0, 5, 0)
    assert everything(store) == before


def test_a_sync_whose_time_is_over_stops_and_goes_on_later(
    result_folder: Path, store: LocalStore
) -> None:
    with pytest.raises(SyncError, match=r"slow, and the time.*is over.*gvr sync"):
        sync(result_folder, store.uri, within=0.0)
    assert sync(result_folder, store.uri, within=60.0).n_created == 5


def test_damaged_pictures_do_not_get_into_mlflow(result_folder: Path, store: LocalStore) -> None:
    next((result_folder / "pictures").rglob("*.png")).write_bytes(b"damaged")
    with pytest.raises(ResultError, match="changed after it was written"):
        sync(result_folder, store.uri)


@pytest.fixture(scope="module")
def reference(_empty_database: Path, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """What an undisturbed sync leaves."""
    result, rows, pictures = make_sample()
    folder = tmp_path_factory.mktemp("reference")
    undisturbed = LocalStore(folder)
    shutil.copy(_empty_database, undisturbed.database)
    sync(write_result(folder / "r", result, rows, pictures), undisturbed.uri)
    return nameless(everything(undisturbed))


@pytest.mark.parametrize(
    ("operation", "calls"),
    [("create_run", 2), ("log_batch", 1), ("log_batch", 4), ("log_artifact", 3), ("set_tag", 2)],
)
def test_continues_where_it_broke_off(
    result_folder: Path,
    store: LocalStore,
    reference: list[str],
    monkeypatch: pytest.MonkeyPatch,
    operation: str,
    calls: int,
) -> None:
    real = getattr(MlflowClient, operation)
    done = 0

    def failing(self: MlflowClient, *arguments: Any, **named: Any) -> Any:
        nonlocal done
        done += 1
        if done > calls:
            raise OSError("disk full")
        return real(self, *arguments, **named)

    with monkeypatch.context() as patch:
        patch.setattr(MlflowClient, operation, failing)
        with pytest.raises(SyncError, match=r"disk full.*is safe.*gvr sync"):
            sync(result_folder, store.uri)
    report = sync(result_folder, store.uri)
    assert report.n_created + report.n_continued + report.n_unchanged == 5
    assert report.n_continued > 0
    assert nameless(everything(store)) == reference


def test_doubles_of_a_lost_answer_are_removed(result_folder: Path, store: LocalStore) -> None:
    sync(result_folder, store.uri)
    before = everything(store)
    with mlflow_client(store.uri) as client:
        run = runs_of(client)["scene", "kitchen", "lift"]
        tags = {k: v for k, v in run.data.tags.items() if k != WHOLE_TAG}
        double = client.create_run(run.info.experiment_id, start_time=1, tags=tags)
    report = sync(result_folder, store.uri)
    assert (report.n_removed, report.n_unchanged) == (1, 5)
    assert everything(store) == before
    with mlflow_client(store.uri) as client:
        trash = client.search_runs([run.info.experiment_id], run_view_type=ViewType.DELETED_ONLY)
    assert [item.info.run_id for item in trash] == [double.info.run_id]


def test_a_parent_that_was_deleted_is_made_again(result_folder: Path, store: LocalStore) -> None:
    first = sync(result_folder, store.uri)
    with mlflow_client(store.uri) as client:
        client.delete_run(first.parent_run)
    second = sync(result_folder, store.uri)
    assert (second.n_created, second.n_unchanged) == (1, 4)
    assert second.parent_run != first.parent_run
    with mlflow_client(store.uri) as client:
        parents = {r.data.tags.get("mlflow.parentRunId") for r in runs_of(client).values()}
    assert parents == {None, second.parent_run}


def test_over_http_as_into_the_file(result_folder: Path, server: Server) -> None:
    url = server.start().url
    report = sync(result_folder, url, "http")
    assert report.n_created == 5
    before = everything(server.store, "http")
    assert sync(result_folder, url, "http").n_unchanged == 5
    assert sync(result_folder, server.store.uri, "http").n_unchanged == 5
    assert everything(server.store, "http") == before
    # What the pages show: the artifact as the server reads it.
    address = f"{url}/get-artifact?path=result.json&run_uuid={report.parent_run}"
    with build_opener(ProxyHandler({})).open(address, timeout=10) as answer:
        assert answer.read() == (result_folder / "result.json").read_bytes()


def test_server_killed_in_the_middle_then_replayed(
    result_folder: Path,
    server: Server,
    reference: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    url = server.start().url
    real = MlflowClient.log_artifact
    done = 0

    def killing(self: MlflowClient, *arguments: Any) -> None:
        nonlocal done
        done += 1
        if done == 2:
            server.kill()
        real(self, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(MlflowClient, "log_artifact", killing)
        started = time.monotonic()
        with pytest.raises(SyncError, match="is safe") as caught:
            sync(result_folder, url, "killed")
        assert time.monotonic() - started < 20
    assert caught.value.tracking_uri == url
    with pytest.raises(SyncError):  # and still down
        sync(result_folder, url, "killed")
    assert server.start().url == url
    report = sync(result_folder, url, "killed")
    assert report.n_continued > 0
    assert report.n_created + report.n_continued + report.n_unchanged == 5
    assert nameless(everything(server.store, "killed")) == reference


@contextmanager
def answering(handler: type[BaseHTTPRequestHandler]) -> Iterator[str]:
    web = HTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=web.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{web.server_port}"
    finally:
        web.shutdown()
        web.server_close()
        thread.join()


def test_a_server_that_asks_for_an_hour_does_not_get_it(result_folder: Path) -> None:
    class Busy(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(503)
            self.send_header("Retry-After", "3600")
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with answering(Busy) as url:
        started = time.monotonic()
        with pytest.raises(SyncError):
            sync(result_folder, url)
        assert time.monotonic() - started < 10


def test_a_silent_server_costs_seconds(
    result_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_TIMEOUT", "1")
    quiet = threading.Event()

    class Silent(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            quiet.wait(30)

        def log_message(self, *_: object) -> None:
            pass

    with answering(Silent) as url:
        started = time.monotonic()
        with pytest.raises(SyncError):
            sync(result_folder, url)
        seconds = time.monotonic() - started
        quiet.set()
    assert 2 <= seconds < 10  # one retry
