"""Lines in MLflow: what their runs are called, and how they are filtered."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from comparison_samples import large_run, small_run
from mlflow.utils import validation
from mlflow_contents import runs_of

from reports.aggregate import aggregate
from reports.mlflow_content import run_contents
from reports.mlflow_run import RunContent
from reports.mlflow_sink import sync
from reports.mlflow_store import EXPERIMENT, LocalStore, mlflow_client
from reports.result_io import write_result


def contents_of(folder: Path, run) -> list[RunContent]:
    result, rows = run
    return run_contents(folder, result, rows, aggregate(rows, result.scenes))


def test_runs_filter_by_label_model_set_and_reference(store: LocalStore, tmp_path: Path) -> None:
    result, rows = large_run(2, 1)
    report = sync(write_result(tmp_path / "run", result, rows), store.uri)
    assert report.n_created == 1 + 2 * 2 * 3
    with mlflow_client(store.uri) as client:
        found = client.get_experiment_by_name(EXPERIMENT)
        assert found is not None

        def names(query: str) -> list[str]:
            runs = client.search_runs([found.experiment_id], query)
            return sorted({run.data.tags["method"] for run in runs})

        assert names("tags.label = 'gvr-robust'") == ["gvr-robust · onboard", "gvr-robust · oracle"]
        assert names("tags.model_set = 'oracle' and tags.label != 'gvr-paper'") == [
            "gvr-robust · oracle",
            "w/o canonical negative no 0 · oracle",
        ]
        assert names("tags.reference = 'gvr-robust · onboard'") == [
            "w/o canonical negative no 0 · onboard"
        ]
        assert names("tags.method = 'gvr-robust · oracle'") == ["gvr-robust · oracle"]
        (params,) = (
            run.data.params
            for key, run in runs_of(client).items()
            if key == ("scene", "hidden_under_a_table_1", "gvr-robust · oracle")
        )
        assert (params["label"], params["model_set"]) == ("gvr-robust", "oracle")


def test_overall_metrics_are_grouped_by_set_and_label(store: LocalStore, tmp_path: Path) -> None:
    result, rows = large_run(2, 1)
    report = sync(write_result(tmp_path / "run", result, rows), store.uri)
    with mlflow_client(store.uri) as client:
        metrics = client.get_run(report.parent_run).data.metrics
        local = client.download_artifacts(report.parent_run, "comparison.json")
    assert metrics["rooms/oracle/gvr-robust/iou_3d"] == 1.0
    assert metrics["rooms/onboard/gvr-paper/iou_3d"] == pytest.approx(0.1)
    table = json.loads(Path(local).read_text())
    lines = [dict(zip(table["columns"], line, strict=True)) for line in table["data"]]
    (robust, *_) = [x for x in lines if (x["label"], x["model_set"]) == ("gvr-robust", "oracle")]
    assert robust["reference"] == "gvr-paper"
    keys = ("difference", "difference_low", "difference_high")
    assert [robust[key] for key in keys] == pytest.approx([0.9] * 3)
    assert (robust["n_pairs"], robust["lowest_scene"]) == (2, "hidden_under_a_table_0")


@pytest.mark.parametrize("run", [small_run, large_run])
def test_mlflow_takes_every_name_as_it_is(tmp_path: Path, run) -> None:
    for content in contents_of(tmp_path, run()):
        for point in content.points:
            validation._validate_metric_name(point.key)
            assert "." not in point.key.rpartition("/")[2] or "acc_at" in point.key
        for key in (*content.tags, *content.params):
            validation._validate_tag_name(key)
        keys = [(point.key, point.step) for point in content.points]
        assert len(keys) == len(set(keys))


def test_a_run_without_model_sets_has_no_empty_tags(tmp_path: Path) -> None:
    parent, base, without, *_ = contents_of(tmp_path, small_run())
    assert "model_set" not in base.tags and "reference" not in base.tags
    assert (without.tags["label"], without.tags["reference"]) == ("w/o votes", "base")
    assert "rooms/w/o votes/iou_3d" in {point.key for point in parent.points}
