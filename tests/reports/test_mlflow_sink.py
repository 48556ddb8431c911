from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest
from mlflow.exceptions import MlflowException
from mlflow_contents import artifacts, runs_of
from record_samples import PLANE, Sample, row, scene_result

from reports.mlflow_run import shown_datasets
from reports.mlflow_sink import _log_inputs, sync
from reports.mlflow_store import EXPERIMENT, LocalStore, SyncError, mlflow_client
from reports.record import SystemLoad
from reports.result_check import ResultError
from reports.result_io import write_result


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
            "gvr.in_scene_2d/1/acc_peak": 2 / 3,
            "miou": 0.6,
            "iou_3d": 0.6,
            "flags_3d/1/recall": 0.675,
            "gvr.in_scene_2d/1/acc_at_0.25": 1.0,
            "gvr.in_scene_2d/1/acc_peak_flat": 2 / 3,
            "gvr.in_scene_2d/1/acc_peak_class_macro": 0.75,
            "gvr.in_scene_2d/1/acc_peak_coverage": 1.0,
            "flags_3d/1/location_error_undefined": 1.0,
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


def test_the_load_of_the_machine_is_drawn_over_the_run(
    sample: Sample, store: LocalStore, tmp_path: Path
) -> None:
    result, rows, pictures = sample
    load = SystemLoad(seconds=(1.0, 2.5), values={"cpu_utilization_percentage": (50.0, 75.0)})
    result = result.model_copy(update={"system": load, "started_by": "schedule"})
    report = sync(write_result(tmp_path / "loaded", result, rows, pictures), store.uri)
    with mlflow_client(store.uri) as client:
        run = client.get_run(report.parent_run)
        points = client.get_metric_history(report.parent_run, "system/cpu_utilization_percentage")
    drawn = [(p.step, p.timestamp - run.info.start_time, p.value) for p in points]
    assert sorted(drawn) == [(0, 1000, 50.0), (1, 2500, 75.0)]
    assert run.data.tags["started_by"] == "schedule"
    assert run.data.tags["mlflow.source.type"] == "JOB"


def test_the_benchmark_has_all_scenes_as_inputs(result_folder: Path, store: LocalStore) -> None:
    report = sync(result_folder, store.uri)
    with mlflow_client(store.uri) as client:
        inputs = client.get_run(report.parent_run).inputs.dataset_inputs
    assert sorted(given.dataset.name for given in inputs) == ["rooms/garden", "rooms/kitchen"]
    assert json.loads(inputs[0].dataset.profile) == {"n_gaussians": 12345, "n_views": 7}


def test_a_data_set_that_another_sync_makes_meanwhile_is_found() -> None:
    class Racing:
        """A double of a client whose every first look at a data set is overtaken."""

        def __init__(self, error: str, times: int) -> None:
            self.error, self.times = error, times

        def log_inputs(self, run_id: str, inputs: list[str]) -> None:
            self.times -= 1
            if self.times >= 0:
                raise MlflowException(self.error)

    _log_inputs(Racing("UNIQUE constraint failed: datasets.name", 2), "r", ["a", "b"])
    with pytest.raises(MlflowException, match="UNIQUE"):
        _log_inputs(Racing("UNIQUE constraint failed: datasets.name", 3), "r", ["a", "b"])
    down = Racing("no answer", 1)
    with pytest.raises(MlflowException, match="no answer"):
        _log_inputs(down, "r", ["a", "b"])
    assert down.times == 0


def test_folders_are_called_by_their_last_part(sample: Sample) -> None:
    result, _, _ = sample
    scene = result.scenes[0]

    def named(*datasets: str) -> list[str]:
        scenes = tuple(scene.model_copy(update={"dataset": name}) for name in datasets)
        return list(shown_datasets(result.model_copy(update={"scenes": scenes})).values())

    assert named("rooms", "folder:/srv/data/mine", "folder:mine2") == ["rooms", "mine", "mine2"]
    assert named("captures:desk", "captures:/srv/data/garden") == ["desk", "garden"]
    assert named("folder:/a/mine", "folder:/b/mine") == ["folder:/a/mine", "folder:/b/mine"]


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
        assert {"summary.json", "summary.md", "report.html"} <= set(parent)
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
