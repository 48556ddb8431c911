from __future__ import annotations

import hashlib
import json
import shutil
import sqlite3
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import ProxyHandler, build_opener, url2pathname

import pytest
from conftest import Server
from mlflow import MlflowClient
from mlflow.entities import Run, ViewType
from record_samples import PLANE, Sample, make_sample, row, scene_result

from reports.mlflow_sink import WHOLE_TAG, sync
from reports.mlflow_store import EXPERIMENT, LocalStore, SyncError, mlflow_client
from reports.result_check import ResultError
from reports.result_io import write_result


def runs_of(client: MlflowClient, experiment: str = EXPERIMENT) -> dict[tuple[str, ...], Run]:
    """All active runs by kind, scene and method; two of one key are an error."""
    found = client.get_experiment_by_name(experiment)
    assert found is not None
    runs = client.search_runs([found.experiment_id], max_results=1000)
    keys = [tuple(r.data.tags.get(t, "") for t in ("kind", "scene", "method")) for r in runs]
    assert max(Counter(keys).values()) == 1
    return dict(zip(keys, runs, strict=True))


def everything(store: LocalStore, experiment: str = EXPERIMENT) -> dict[str, Any]:
    """All that MLflow holds of an experiment: what must not change when a sync is repeated.

    Read from the database itself, so that a point stored twice is seen twice.
    """
    tables = {
        "tags": "select key, value from tags where run_uuid = ?",
        "params": "select key, value from params where run_uuid = ?",
        "points": "select key, step, timestamp, value, is_nan from metrics where run_uuid = ?",
        "latest": "select key, step, timestamp, value from latest_metrics where run_uuid = ?",
        "inputs": "select d.name, d.digest, d.dataset_source from inputs i"
        " join datasets d on d.dataset_uuid = i.source_id where i.destination_id = ?",
    }
    content: dict[str, Any] = {}
    with closing(sqlite3.connect(store.database)) as database:
        runs = database.execute(
            "select run_uuid, r.name, status, start_time, end_time, artifact_uri from runs r"
            " join experiments e using (experiment_id)"
            " where e.name = ? and r.lifecycle_stage = 'active'",
            [experiment],
        ).fetchall()
        for run_id, *head, uri in runs:
            root = Path(url2pathname(urlsplit(uri).path))
            content[run_id] = {
                "head": head,
                **{name: sorted(database.execute(sql, [run_id])) for name, sql in tables.items()},
                "artifacts": sorted(
                    (str(path.relative_to(root)), hashlib.sha256(path.read_bytes()).hexdigest())
                    for path in root.rglob("*")
                    if path.is_file()
                ),
            }
    return content


def nameless(content: dict[str, Any]) -> list[str]:
    """The same without MLflow's own ids, which differ between two fillings."""
    text = {run_id: json.dumps(run, sort_keys=True) for run_id, run in content.items()}
    for run_id in content:
        text = {key: value.replace(run_id, "ID") for key, value in text.items()}
    return sorted(text.values())


def artifacts(client: MlflowClient, run_id: str, path: str = "") -> Iterator[tuple[str, str]]:
    for item in client.list_artifacts(run_id, path):
        if item.is_dir:
            yield from artifacts(client, run_id, item.path)
        else:
            local = Path(client.download_artifacts(run_id, item.path))
            yield item.path, hashlib.sha256(local.read_bytes()).hexdigest()


def forget_whole(uri: str) -> int:
    """Take the mark off every run, so that a sync writes everything once more."""
    with mlflow_client(uri) as client:
        runs = runs_of(client).values()
        for run in runs:
            client.delete_tag(run.info.run_id, WHOLE_TAG)
        return len(runs)


def test_metrics_are_the_records(result_folder: Path, store: LocalStore) -> None:
    report = sync(result_folder, store.uri)
    assert (report.n_created, report.n_continued, report.n_unchanged) == (5, 0, 0)
    assert (report.n_left_out, report.n_removed) == (0, 0)
    with mlflow_client(store.uri) as client:
        runs = runs_of(client)
        assert set(runs) == {
            ("benchmark", "", ""),
            ("scene", "kitchen", "gvr-paper"),
            ("scene", "garden", "gvr-paper"),
            ("scene", "kitchen", "lift"),
            ("scene", "garden", "lift"),
        }
        kitchen = runs["scene", "kitchen", "gvr-paper"]
        expected = {
            "acc": 2 / 3,
            "acc_peak": 2 / 3,
            "miou": 0.6,
            "iou_3d": 0.6,
            "recall_3d": 0.675,
            "acc_at_0.25": 1.0,
            "class_macro/acc": 0.75,
            "coverage/acc": 1.0,
            "n_undefined/location_error_3d": 1.0,
            "n_absent_refused": 1.0,
            "found": 2 / 3,
            "prepare_seconds": 12.5,
            "query_seconds": 0.75,
            "peak_memory_mb": 500 * 2**20 / 1e6,
            "stage_seconds/masks": 10.0,
            "stage_cached/encode": 1.0,
        }
        shown = {name: kitchen.data.metrics.get(name) for name in expected}
        assert shown == pytest.approx(expected)
        assert "miou" not in runs["scene", "garden", "lift"].data.metrics
        parent = runs["benchmark", "", ""]
        assert parent.info.run_id == report.parent_run
        overall = {
            "rooms/gvr-paper/acc": 1 / 3,
            "rooms/gvr-paper/miou": 0.4,
            "rooms/gvr-paper/miou_micro": 0.5,
            "rooms/gvr-paper/iou_3d": 0.45,
            "rooms/lift/n_failed": 1.0,
            "wall_seconds": 61.5,
        }
        assert {name: parent.data.metrics.get(name) for name in overall} == pytest.approx(overall)


def test_queries_are_steps_and_a_table(result_folder: Path, store: LocalStore) -> None:
    sync(result_folder, store.uri)
    with mlflow_client(store.uri) as client:
        run_id = runs_of(client)["scene", "kitchen", "gvr-paper"].info.run_id

        def steps(key: str) -> dict[int, float]:
            return {m.step: m.value for m in client.get_metric_history(run_id, key)}

        assert steps("query/acc") == {0: 0.5, 1: 1.0}
        assert steps("query/miou") == pytest.approx({0: 0.6, 1: 0.6})
        assert steps("query/found") == {0: 1.0, 1: 1.0, 2: 0.0}
        assert steps("query_seconds/segment") == {0: 0.5, 1: 0.5, 2: 0.5}
        local = Path(client.download_artifacts(run_id, "queries.json"))
        content = json.loads(local.read_text())
        lines = [dict(zip(content["columns"], line, strict=True)) for line in content["data"]]
        assert [line["text"] for line in lines] == ["the cup", "the plate", "the unicorn"]
        assert [line["absent"] for line in lines] == [False, False, True]
        assert lines[2]["miou"] is None and lines[2]["found"] is False
        tags = client.get_run(run_id).data.tags
        assert json.loads(tags["mlflow.loggedArtifacts"]) == [
            {"path": "queries.json", "type": "table"}
        ]


def test_params_inputs_and_environment(result_folder: Path, store: LocalStore) -> None:
    sync(result_folder, store.uri)
    with mlflow_client(store.uri) as client:
        run = runs_of(client)["scene", "kitchen", "gvr-paper"]
    params = run.data.params
    assert params["method"] == "gvr-paper"
    assert params["model.encoder"] == "conse/1"
    assert (params["n_views"], params["n_gaussians"]) == ("7", "12345")
    assert params["resolution"] == "320x240"
    assert params["digest.gaussians"] == "a" * 64
    assert params["config.suite.seed"] == "0"
    assert params["config.suite.names"] == '["a", "b"]'
    assert params["config.note"].startswith("xxx") and "cut" in params["config.note"][-40:]
    assert run.data.tags["package.torch"] == "2.15.0"
    assert run.data.tags["mlflow.source.git.commit"].startswith("0123456789abcdef")
    assert run.data.tags["headline.acc"] == f"acc_peak of {PLANE}"
    assert [item.dataset.name for item in run.inputs.dataset_inputs] == ["rooms/kitchen"]


def test_artifacts_are_the_records_files(
    sample: Sample, result_folder: Path, store: LocalStore
) -> None:
    sync(result_folder, store.uri)
    _, _, pictures = sample
    with mlflow_client(store.uri) as client:
        runs = runs_of(client)
        parent = dict(artifacts(client, runs["benchmark", "", ""].info.run_id))
        for name in ("result.json", "rows.jsonl", "rows.parquet"):
            content = (result_folder / name).read_bytes()
            assert parent[name] == hashlib.sha256(content).hexdigest()
        assert {"summary.json", "summary.md"} <= set(parent)
        kitchen = dict(artifacts(client, runs["scene", "kitchen", "gvr-paper"].info.run_id))
    own = {
        name: hashlib.sha256(p).hexdigest() for name, p in pictures.items() if "kitchen-gvr" in name
    }
    assert len(own) == 3
    assert {name: kitchen[name] for name in own} == own
    assert set(kitchen) == {*own, "queries.json"}


def test_a_filter_on_the_benchmark_finds_its_scenes(result_folder: Path, store: LocalStore) -> None:
    report = sync(result_folder, store.uri)
    with mlflow_client(store.uri) as client:
        found = client.get_experiment_by_name(EXPERIMENT)
        assert found is not None
        children = client.search_runs(
            [found.experiment_id],
            "tags.suite = 'smoke' and tags.method = 'lift' and tags.scene = 'kitchen'",
        )
        assert len(children) == 1
        assert children[0].data.tags["mlflow.parentRunId"] == report.parent_run
        whole = client.search_runs([found.experiment_id], "tags.`gvr.run_id` LIKE '20250102%'")
        assert len(whole) == 5
        failed = client.search_runs([found.experiment_id], "attributes.status = 'FAILED'")
        assert {run.data.tags["kind"] for run in failed} == {"benchmark", "scene"}


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
    [("create_run", 2), ("log_batch", 1), ("log_batch", 8), ("log_artifact", 3), ("set_tag", 2)],
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


def test_two_results_stand_side_by_side(
    sample: Sample, result_folder: Path, store: LocalStore, tmp_path: Path
) -> None:
    result, rows, pictures = sample
    other = result.model_copy(update={"run_id": "20250103T000000Z-000000"})
    sync(result_folder, store.uri)
    report = sync(write_result(tmp_path / "other", other, rows, pictures), store.uri)
    assert report.n_created == 5


def test_many_queries_and_settings(sample: Sample, store: LocalStore, tmp_path: Path) -> None:
    """More points, parameters and letters than MLflow takes in one request."""
    result, _, _ = sample
    names = [f"q{i:04}" for i in range(400)]
    scene = scene_result("kitchen", "gvr-paper", names)
    scene = scene.model_copy(
        update={"queries": tuple(q.model_copy(update={"picture": None}) for q in scene.queries)}
    )
    config = {"deep": {f"key{i}": "y" * 8000 for i in range(250)}}
    result = result.model_copy(update={"scenes": (scene,), "config": config})
    rows = [row(name, PLANE, {"iou": 0.5, "acc_peak": 1.0}, view="v") for name in names]
    sync(write_result(tmp_path / "large", result, rows), store.uri)
    with mlflow_client(store.uri) as client:
        run = runs_of(client)["scene", "kitchen", "gvr-paper"]
        history = client.get_metric_history(run.info.run_id, "query/acc")
    assert [m.step for m in sorted(history, key=lambda m: m.step)] == list(range(400))
    assert sum(name.startswith("config.deep.") for name in run.data.params) == 250


def test_no_result_and_no_experiment(
    result_folder: Path, store: LocalStore, tmp_path: Path
) -> None:
    with pytest.raises(ResultError, match="no such folder"):
        sync(tmp_path / "nowhere", store.uri)
    sync(result_folder, store.uri, "old")
    with mlflow_client(store.uri) as client:
        old = client.get_experiment_by_name("old")
        assert old is not None
        client.delete_experiment(old.experiment_id)
    with pytest.raises(SyncError, match="trash"):
        sync(result_folder, store.uri, "old")


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
