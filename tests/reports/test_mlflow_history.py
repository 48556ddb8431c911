"""Benchmarks over time: one run a line, one point a benchmark, however often it is synced."""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from killable_server import Server
from mlflow import MlflowClient
from mlflow.entities import Metric, Run
from mlflow_contents import everything
from record_samples import Sample, make_sample

from reports.mlflow_history import history_experiment
from reports.mlflow_sink import sync
from reports.mlflow_store import EXPERIMENT, LocalStore, SyncError, mlflow_client
from reports.record import Result
from reports.result_io import write_result

REPOSITORY = Path(__file__).resolve().parents[2]
OVER_TIME = history_experiment(EXPERIMENT)


def night(sample: Sample, tmp_path: Path, day: int, **changes: object) -> Path:
    """The sample as it was on a day of January."""
    result, rows, pictures = sample
    update = {
        "run_id": f"202501{day:02}T020000Z-{len(changes):06}",
        "created": f"2025-01-{day:02}T02:00:00+00:00",
    }
    later: Result = result.model_copy(update=update | changes)
    return write_result(tmp_path / later.run_id, later, rows, pictures)


def histories(client: MlflowClient) -> dict[str, Run]:
    found = client.get_experiment_by_name(OVER_TIME)
    assert found is not None
    return {run.info.run_name: run for run in client.search_runs([found.experiment_id])}


def points(client: MlflowClient, run: Run, key: str) -> list[Metric]:
    history = client.get_metric_history(run.info.run_id, key)
    return sorted(history, key=lambda point: point.timestamp)


def test_nights_are_points_of_one_line(sample: Sample, store: LocalStore, tmp_path: Path) -> None:
    for day in (1, 2, 3):
        sync(night(sample, tmp_path, day), store.uri)
    with mlflow_client(store.uri) as client:
        runs = histories(client)
        assert set(runs) == {"gvr-paper · rooms (2 scenes)", "lift · rooms (2 scenes)"}
        paper = runs["gvr-paper · rooms (2 scenes)"]
        found = points(client, paper, "overall/miou")
        assert [point.value for point in found] == pytest.approx([0.4] * 3)
        assert [point.step for point in found] == [1, 2, 3]
        assert {b.timestamp - a.timestamp for a, b in pairwise(found)} == {24 * 3600 * 1000}
        assert points(client, paper, "scene/kitchen/miou")[0].value == pytest.approx(0.6)
        # lift failed in the garden: its mean would be one over the kitchen alone.
        lift = runs["lift · rooms (2 scenes)"].data.metrics
        assert lift["overall/n_failed"] == 1.0
        assert "overall/miou" not in lift
        assert lift["scene/kitchen/miou"] == 0.5


def test_again_changes_nothing(sample: Sample, store: LocalStore, tmp_path: Path) -> None:
    folders = [night(sample, tmp_path, day) for day in (1, 2)]
    for folder in folders:
        sync(folder, store.uri)
    before = everything(store, OVER_TIME)
    assert len(before) == 2
    for folder in reversed(folders):
        sync(folder, store.uri)
    assert everything(store, OVER_TIME) == before


def test_a_night_that_was_lost_comes_later(
    sample: Sample, store: LocalStore, tmp_path: Path
) -> None:
    folders = [night(sample, tmp_path, day) for day in (1, 2, 3)]
    for i in (0, 2, 1):
        sync(folders[i], store.uri)
    with mlflow_client(store.uri) as client:
        found = points(client, histories(client)["gvr-paper · rooms (2 scenes)"], "overall/miou")
    assert [point.step for point in found] == [1, 3, 2]


def test_histories_that_were_deleted_are_made_again(
    sample: Sample, store: LocalStore, tmp_path: Path
) -> None:
    folders = [night(sample, tmp_path, day) for day in (1, 2)]
    for folder in folders:
        sync(folder, store.uri)
    with mlflow_client(store.uri) as client:
        for run in histories(client).values():
            client.delete_run(run.info.run_id)
    for folder in folders:
        assert sync(folder, store.uri).n_unchanged == 5
    with mlflow_client(store.uri) as client:
        found = points(client, histories(client)["gvr-paper · rooms (2 scenes)"], "overall/miou")
    assert len(found) == 2


def test_who_deletes_the_experiment_gets_none(
    sample: Sample, store: LocalStore, tmp_path: Path
) -> None:
    sync(night(sample, tmp_path, 1), store.uri)
    with mlflow_client(store.uri) as client:
        found = client.get_experiment_by_name(OVER_TIME)
        assert found is not None
        client.delete_experiment(found.experiment_id)
    assert sync(night(sample, tmp_path, 2), store.uri).n_created == 5


@pytest.mark.parametrize(
    "changes",
    [
        {"config": {"limit": 3}},
        {"environment": make_sample()[0].environment.model_copy(update={"cpu_count": 64})},
        {"scenes": make_sample()[0].scenes[:1] + make_sample()[0].scenes[2:3]},
    ],
    ids=["fewer queries", "another machine", "fewer scenes"],
)
def test_what_does_not_compare_is_another_line(
    sample: Sample, store: LocalStore, tmp_path: Path, changes: dict[str, object]
) -> None:
    sync(night(sample, tmp_path, 1), store.uri)
    result, rows, pictures = sample
    other = result.model_copy(update={"run_id": "other", **changes})
    lines = {(item.scene, item.method) for item in other.scenes}
    kept = [row for row in rows if (row.scene, row.method) in lines]
    shown = {query.picture for item in other.scenes for query in item.queries}
    drawn = {name: content for name, content in pictures.items() if name in shown}
    sync(write_result(tmp_path / "other", other, kept, drawn), store.uri)
    assert len(everything(store, OVER_TIME)) == 4


def test_a_result_that_was_only_scored_again_adds_nothing(
    sample: Sample, store: LocalStore, tmp_path: Path
) -> None:
    result, rows, pictures = sample
    again = result.model_copy(update={"config": {"scored_from": "20250101"}})
    sync(write_result(tmp_path / "again", again, rows, pictures), store.uri)
    with mlflow_client(store.uri) as client:
        assert client.get_experiment_by_name(OVER_TIME) is None


def test_a_double_of_a_lost_answer_is_removed(
    sample: Sample, store: LocalStore, tmp_path: Path
) -> None:
    sync(night(sample, tmp_path, 1), store.uri)
    before = everything(store, OVER_TIME)
    with mlflow_client(store.uri) as client:
        run = next(iter(histories(client).values()))
        client.create_run(run.info.experiment_id, start_time=1, tags=run.data.tags)
    sync(tmp_path / "20250101T020000Z-000000", store.uri)
    assert everything(store, OVER_TIME) == before


def test_continues_where_it_broke_off(
    sample: Sample, store: LocalStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = night(sample, tmp_path, 1)
    real = MlflowClient.log_batch

    def failing(self: MlflowClient, run_id: str, *arguments: Any, **named: Any) -> Any:
        if self.get_run(run_id).data.tags["kind"] == "history":
            raise OSError("disk full")
        return real(self, run_id, *arguments, **named)

    with monkeypatch.context() as patch:
        patch.setattr(MlflowClient, "log_batch", failing)
        with pytest.raises(SyncError, match="disk full"):
            sync(folder, store.uri)
    assert sync(folder, store.uri).n_unchanged == 5
    with mlflow_client(store.uri) as client:
        runs = histories(client)
        assert len(runs) == 2
        assert all(run.info.status == "FINISHED" for run in runs.values())
        found = points(client, runs["gvr-paper · rooms (2 scenes)"], "overall/miou")
    assert [(point.step, point.value) for point in found] == [(1, pytest.approx(0.4))]


def test_two_syncs_at_once_share_their_histories(
    sample: Sample, store: LocalStore, tmp_path: Path
) -> None:
    folders = [night(sample, tmp_path, day) for day in (1, 2)]
    code = "import sys; from reports.mlflow_sink import sync; sync(Path(sys.argv[1]), sys.argv[2])"
    command = [sys.executable, "-c", f"from pathlib import Path; {code}"]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    started = [
        subprocess.Popen([*command, str(folder), store.uri], env=environment) for folder in folders
    ]
    assert [process.wait(timeout=120) for process in started] == [0, 0]
    with mlflow_client(store.uri) as client:
        runs = histories(client)
        assert len(everything(store, OVER_TIME)) == len(runs) == 2
        found = points(client, runs["gvr-paper · rooms (2 scenes)"], "overall/miou")
    assert sorted(point.step for point in found) == [1, 2]


def test_over_http_as_into_the_file(sample: Sample, server: Server, tmp_path: Path) -> None:
    url = server.start().url
    folder = night(sample, tmp_path, 1)
    sync(folder, url, "nights")
    before = everything(server.store, "nights over time")
    assert len(before) == 2
    sync(folder, server.store.uri, "nights")
    assert everything(server.store, "nights over time") == before
