"""The three published layouts, end to end: exported trees, every method, the paper's table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from datasets.export_lerf_mask import export_lerf_mask
from datasets.export_lerf_ovs import export_lerf_ovs
from datasets.export_ovs3d import export_ovs3d
from datasets.images import write_png
from datasets.native import read_scene
from datasets.registry import get_dataset
from gvr_core.metrics import REFUSAL
from gvr_core.protocols import PROTOCOLS
from gvr_core.rendering import get_renderer
from reports.aggregate import aggregate
from reports.record import Result, Row
from reports.result_io import read_result

EXPORTS: dict[str, Callable[..., object]] = {
    "lerf_ovs": export_lerf_ovs,
    "lerf_mask": export_lerf_mask,
    "ovs3d": export_ovs3d,
}
MAIN = {
    "lerf_ovs": "lerf_ovs.langsplat_2d/1",
    "lerf_mask": "lerf_mask.gg/1",
    "ovs3d": "ovs3d.binary/1",
}
LINES = [
    "gvr-paper",
    "w/o RFL",
    "w/o SMFI",
    "w/o RFL and SMFI",
    "gvr-robust",
    "lift",
    "random-patch",
]


@pytest.fixture(scope="module")
def trees(two_boxes_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("benchmarks")
    data = read_scene(two_boxes_folder / "two-boxes")
    for name, export in EXPORTS.items():
        export(data, root / name, get_renderer("numba"))
    return root


def suite(path: Path, name: str, root: Path) -> str:
    path.write_text(
        f"""
name = "{name}"
[[datasets]]
name = "{name}"
settings = {{ root = "{root / name}" }}
[[methods]]
method = "gvr-paper"
leave_one_out = true
[[methods]]
method = "gvr-robust"
[[methods]]
method = "lift"
[[methods]]
method = "random-patch"
"""
    )
    return str(path)


def run(gvr, home: Path, *arguments: str) -> tuple[Result, tuple[Row, ...], str]:
    code, out, error = gvr("run", *arguments, "--quiet", "--no-mlflow")
    assert code == 0, error
    newest = max((home / "results").iterdir(), key=lambda path: path.stat().st_mtime_ns)
    return (*read_result(newest), out)


@pytest.mark.parametrize("name", EXPORTS)
def test_every_method_runs_on_the_layout_and_is_scored_by_its_protocol(
    gvr, home, tmp_path, trees, name, prefect_server
) -> None:
    result, rows, out = run(gvr, home, suite(tmp_path / "suite.toml", name, trees))
    assert [scene.method for scene in result.scenes] == LINES
    assert all(scene.status == "completed" for scene in result.scenes)
    summary = aggregate(rows, result.scenes)
    spec = PROTOCOLS[MAIN[name]]
    for line in LINES:
        found = summary.scene(name, "two-boxes", line, spec.id)
        assert found is not None
        for metric, _ in spec.headline:
            mean = found.metrics[metric]
            assert 0 <= mean.mean <= 1 and mean.coverage == 1
            assert mean.n == 4, "two boxes in two views"
    titles = [title for _, title in spec.headline]
    assert all(title in out for title in titles) and "overall" in out


@pytest.mark.parametrize("name", EXPORTS)
def test_the_truth_as_predictions_scores_everything_there_is(
    gvr, home, tmp_path, trees, name, prefect_server
) -> None:
    data = get_dataset(name, {"root": str(trees / name)}).load("two-boxes")
    folder = tmp_path / "truth" / "two-boxes"
    for view in data.truth.test_views:
        for query in data.queries:
            target = str(query.target)
            if data.truth.is_labelled(view, target):
                (folder / view.name).mkdir(parents=True, exist_ok=True)
                mask = data.truth.mask(view, target)
                write_png(folder / view.name / f"{query.text}.png", mask)
    path = tmp_path / "truth.toml"
    path.write_text(
        f"""
name = "{name}"
[[datasets]]
name = "{name}"
settings = {{ root = "{trees / name}" }}
[[methods]]
method = "predictions"
label = "truth"
predictions = {{ folder = "{tmp_path / "truth"}" }}
"""
    )
    result, rows, _ = run(gvr, home, str(path))
    assert result.scenes[0].status == "completed", result.scenes[0].error
    scored = [row for row in rows if row.protocol in data.protocols and row.view is not None]
    assert {row.protocol for row in scored} == set(data.protocols) - {REFUSAL}
    first = min(str(query.target) for query in data.queries)
    for row in scored:
        # Closed-set: what no class claims goes to the class that sorts first, here the floor too.
        if (row.protocol, row.target) != ("ovs3d.exclusive/1", first):
            assert row.metrics["iou"] == 1, (row.protocol, row.text, row.view)
    pairs = sum(
        data.truth.is_labelled(view, name)
        for view in data.truth.test_views
        for name in data.truth.objects
    )
    for protocol_id in set(data.protocols) - {REFUSAL}:
        assert sum(row.protocol == protocol_id for row in scored) == pairs
    for row in scored:
        if row.protocol == "lerf_ovs.langsplat_2d/1":
            assert row.metrics["acc"] == 1
        if row.protocol == "lerf_mask.gg/1":
            assert row.metrics["boundary_iou"] == 1


def test_a_published_scene_name_brings_published_rows_and_differences_with_a_warning(
    gvr, home, tmp_path, two_boxes_folder, prefect_server
) -> None:
    data = read_scene(two_boxes_folder / "two-boxes")
    named = replace(data, scene=replace(data.scene, name="ramen"))
    export_lerf_ovs(named, tmp_path / "lerf_ovs", get_renderer("numba"))
    path = suite(tmp_path / "suite.toml", "lerf_ovs", tmp_path)
    result, _, out = run(gvr, home, path, "--method", "gvr-paper", "--scene", "ramen")
    assert not result.scenes[0].original, "an export under a published name is no original"
    shown = " ".join(out.split())
    assert "GVR†" in shown and "LangSplat†" in shown
    assert "measured minus published†" in shown and "gvr-paper - GVR†" in shown
    assert "published on the original data, not on these scenes" in shown


def test_leakage_audit_takes_the_labelled_frames_out_of_the_books(
    gvr, home, tmp_path, trees, prefect_server
) -> None:
    path = suite(tmp_path / "suite.toml", "lerf_ovs", trees)
    usual, _, _ = run(gvr, home, path, "--method", "random-patch")
    audit, _, _ = run(gvr, home, path, "--method", "random-patch", "--exclude-eval-views")
    assert audit.scenes[0].n_views == usual.scenes[0].n_views - 2
    assert all(timing.state == "computed" for timing in audit.scenes[0].stages[:2])


def test_a_data_set_that_nobody_placed_is_told(gvr, home, monkeypatch) -> None:
    monkeypatch.delenv("GVR_DATASETS", raising=False)
    code, _, error = gvr("run", "lerf_ovs", "--models", "onboard", "--no-mlflow")
    assert code == 2 and "GVR_DATASETS" in error
