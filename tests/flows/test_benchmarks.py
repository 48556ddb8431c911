"""The three published layouts, end to end: exported trees, every method, the paper's table."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from datasets.export_lerf_mask import export_lerf_mask
from datasets.export_lerf_ovs import export_lerf_ovs
from datasets.export_ovs3d import export_ovs3d
from datasets.native import read_scene
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
    return (*read_result(max((home / "results").iterdir())), out)


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
    titles = [title for _, title in spec.headline]
    assert all(title in out for title in titles) and "overall" in out

    best = summary.scene(name, "two-boxes", "gvr-paper", spec.id)
    chance = summary.scene(name, "two-boxes", "random-patch", spec.id)
    assert best is not None and chance is not None


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
