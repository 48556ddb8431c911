"""A suite with two sets of models and variants, from the TOML file to tables and MLflow."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from mlflow import MlflowClient

from reports.comparison import compare
from reports.record import Result, SceneResult
from reports.result_io import read_result

SUITE = """
name = "sets"
[[datasets]]
name = "folder:{folder}"
[[methods]]
method = "gvr-paper"
leave_one_out = true
[[methods]]
method = "lift"
[[models]]
label = "oracle"
segmenter = "oracle"
encoder = "oracle"
text_segmenter = "oracle"
[[models]]
label = "chance"
segmenter = "oracle"
encoder = "random:3"
text_segmenter = "oracle"
"""
LABELS = ["gvr-paper", "w/o RFL", "w/o SMFI", "w/o RFL and SMFI", "lift"]


@pytest.fixture
def suite_path(tmp_path: Path, two_boxes_folder: Path) -> str:
    path = tmp_path / "sets.toml"
    path.write_text(SUITE.format(folder=two_boxes_folder))
    return str(path)


def states(scene: SceneResult) -> dict[str, str]:
    assert scene.status == "completed", scene.error
    return {timing.stage: timing.state for timing in scene.stages}


def newest(home: Path) -> Path:
    return max((home / "results").iterdir(), key=lambda path: path.stat().st_mtime_ns)


def test_two_model_sets_through_the_whole_flow(
    gvr, home, tmp_path, suite_path, prefect_server
) -> None:
    uri = f"sqlite:///{tmp_path / 'mlflow.db'}"
    code, out, err = gvr("run", suite_path, "--quiet", "--tracking-uri", uri)
    assert code == 0, err
    folder = newest(home)
    result, rows = read_result(folder)
    scenes = {scene.method: scene for scene in result.scenes}
    assert list(scenes) == [f"{label} · {s}" for s in ("oracle", "chance") for label in LABELS]
    _check_what_is_shared(scenes)
    _check_models_and_pictures(folder, scenes)

    lines = {line.name: line for line in compare(result, rows, result.scenes[0].dataset)}
    good, chance = lines["gvr-paper · oracle"], lines["gvr-paper · chance"]
    assert good.iou_3d is not None and chance.iou_3d is not None
    assert good.iou_3d.value >= 0.75 > chance.iou_3d.value
    assert [lines[f"{label} · chance"].reference for label in LABELS] == [None, *["gvr-paper"] * 4]
    without = lines["w/o SMFI · oracle"]
    assert without.difference is not None and without.iou_3d is not None
    gained = without.iou_3d.value - good.iou_3d.value
    assert without.difference.estimate.value == pytest.approx(gained)
    assert (without.difference.n_pairs, without.difference.n_missing) == (3, 0)
    assert "oracle models: 3D IoU, per cent" in out

    client = MlflowClient(tracking_uri=uri)
    experiment = client.get_experiment_by_name("gvr-bench")
    assert experiment is not None
    found = client.search_runs(
        [experiment.experiment_id], "tags.model_set = 'chance' and tags.label = 'w/o RFL'"
    )
    assert [run.data.tags["reference"] for run in found] == ["gvr-paper · chance"]
    _check_document(gvr, tmp_path, folder, result)


def _check_what_is_shared(scenes: dict[str, SceneResult]) -> None:
    """What was computed for one line is found again by the next, where nothing changed."""
    assert set(states(scenes["gvr-paper · oracle"]).values()) == {"computed"}
    ablated = states(scenes["w/o SMFI · oracle"])
    assert [stage for stage, state in ablated.items() if state == "computed"] == [
        "segment",
        "evaluate",
    ]
    # The other set has the same segmenter and another encoder.
    other = states(scenes["gvr-paper · chance"])
    assert [stage for stage, state in other.items() if state == "cached"] == [
        "render",
        "depth",
        "masks",
    ]


def _check_models_and_pictures(folder: Path, scenes: dict[str, SceneResult]) -> None:
    for name, scene in scenes.items():
        assert scene.models["segmenter"].startswith("oracle/1(")
        assert scene.models["encoder"].startswith("oracle/1(" if "oracle" in name else "random")
        # The variants' pictures are left out.
        assert [q.picture is None for q in scene.queries] == [name.startswith("w/o")] * 4
    kept = {query.picture for scene in scenes.values() for query in scene.queries} - {None}
    on_disk = {path.relative_to(folder).as_posix() for path in folder.rglob("*.png")}
    assert kept == on_disk
    assert len(kept) == 2 * 2 * 4


def _check_document(gvr, tmp_path: Path, folder: Path, result: Result) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- sets -->\n<!-- /sets -->\nafter\n")
    code, _, err = gvr("show", folder.name, "--into", str(page))
    assert code == 0, err
    text = page.read_text()
    assert text.startswith("before\n<!-- sets -->\nSuite `sets`, run `" + result.run_id)
    assert text.endswith("<!-- /sets -->\nafter\n")
    code, out, _ = gvr("show", folder.name, "--markdown")
    assert out.strip() in text
    page.write_text("nothing\n")
    code, _, err = gvr("show", folder.name, "--into", str(page))
    assert code == 2
    assert "<!-- sets -->" in err
    assert page.read_text() == "nothing\n"


def test_picked_on_the_command_line(gvr, home, suite_path, prefect_server) -> None:
    picks = ("--models", "oracle", "--method", "w/o SMFI", "--method", "lift", "--limit", "1")
    code, _, err = gvr("run", suite_path, *picks, "--quiet", "--no-mlflow")
    assert code == 0, err
    saved = json.loads((newest(home) / "result.json").read_text())
    assert [(s["method"], s["reference"]) for s in saved["scenes"]] == [
        ("w/o SMFI · oracle", None),
        ("lift · oracle", "w/o SMFI · oracle"),
    ]
    assert {len(scene["queries"]) for scene in saved["scenes"]} == {1}


def test_oracles_on_a_scene_without_labels_fail_with_a_reason(
    gvr, home, tmp_path, suite_path, prefect_server, monkeypatch
) -> None:
    import dataclasses

    from flows import scene as scene_module

    real = scene_module.load_scene

    def unlabelled(choice, scene, exclude_eval_views):
        data = real(choice, scene, exclude_eval_views)
        return dataclasses.replace(data, truth=dataclasses.replace(data.truth, labels=None))

    monkeypatch.setattr(scene_module, "load_scene", unlabelled)
    picks = ("--models", "oracle", "--method", "lift")
    code, _, err = gvr("run", suite_path, *picks, "--quiet", "--no-mlflow")
    assert code == 2
    assert "oracle models need to know the truth" in err
    assert "Traceback" not in err
