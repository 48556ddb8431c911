"""The command line: exit codes, one-line errors, and nothing half-written after bad input."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from mlflow import MlflowClient

from tasks.prefect_runtime import PrefectRuntime

REPOSITORY = Path(__file__).resolve().parents[2]
PLY = "point_cloud/iteration_30000/point_cloud.ply"


def suite_file(tmp_path: Path, folder: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(
        f'name = "small"\n[[datasets]]\nname = "folder:{folder}"\n'
        '[models]\nsegmenter = "oracle"\nencoder = "oracle"\ntext_segmenter = "oracle"\n'
    )
    return path


def stored_files(home: Path) -> list[Path]:
    """Objects and records in the store; half-written files would be among them."""
    root = home / "store"
    return [path for path in root.rglob("*") if path.is_file() and "locks" not in path.parts]


def test_run_prints_tables_writes_a_result_and_fills_mlflow(
    gvr, home, tmp_path, two_boxes_folder, prefect_server: PrefectRuntime
) -> None:
    uri = f"sqlite:///{tmp_path / 'mlflow.db'}"
    suite = str(suite_file(tmp_path, two_boxes_folder))
    code, out, err = gvr("run", suite, "--quiet", "--tracking-uri", uri)
    assert code == 0, err
    (folder,) = (home / "results").iterdir()
    assert folder.name in out
    result = json.loads((folder / "result.json").read_text())
    assert [scene["status"] for scene in result["scenes"]] == ["completed"]

    client = MlflowClient(tracking_uri=uri)
    experiment = client.get_experiment_by_name("gvr-bench")
    assert experiment is not None
    runs = client.search_runs([experiment.experiment_id])
    (child,) = [run for run in runs if "mlflow.parentRunId" in run.data.tags]
    assert len(runs) == 2
    metrics = child.data.metrics
    rows = [json.loads(line) for line in (folder / "rows.jsonl").read_text().splitlines()]
    ious = [row["metrics"]["iou"] for row in rows if row["protocol"] == "flags_3d/1"]
    assert metrics["iou_3d"] == pytest.approx(np.mean(ious))
    for name in ("acc", "miou", "prepare_seconds", "query_seconds", "peak_memory_mb"):
        assert np.isfinite(metrics[name]), name
    history = client.get_metric_history(child.info.run_id, "iou_3d")
    assert history
    pictures = client.list_artifacts(child.info.run_id, "pictures")
    assert len(pictures) >= 1

    code, out, _ = gvr("show", folder.name, "--markdown")
    assert code == 0
    assert "gvr-paper" in out
    code, out, _ = gvr("cache", "verify")
    assert code == 0
    assert "0 problems" in out
    code, out, _ = gvr("cache", "ls")
    assert all(stage in out for stage in ("render", "masks", "evaluate"))


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["run", "nightly"], ["nightly", "bench"]),
        (["run", "--method", "gvr"], ["gvr", "gvr-paper"]),
        (["run", "--dataset", "lerf"], ["lerf", "gallery"]),
        (["run", "--scene", "kitchen"], ["kitchen", "gallery_0"]),
        (["run", "--limit", "0"], ["--limit", "1 or more"]),
        (["run", "folder.toml"], ["folder.toml", "cannot be read"]),
        (["show", "20260101"], ["20260101"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_unknown_names_exit_with_2_and_list_the_known(gvr, home, arguments, expected) -> None:
    code, _, err = gvr(*arguments)
    assert code == 2
    for part in expected:
        assert part in err
    assert "Traceback" not in err
    assert not stored_files(home)


def corrupt_missing_column(scene: Path) -> None:
    path = scene / PLY
    path.write_bytes(path.read_bytes().replace(b"property float opacity\n", b""))


def corrupt_nan(scene: Path) -> None:
    path = scene / PLY
    data = bytearray(path.read_bytes())
    start = data.index(b"end_header\n") + len(b"end_header\n")
    data[start : start + 4] = np.float32(np.nan).tobytes()
    path.write_bytes(bytes(data))


def corrupt_empty(scene: Path) -> None:
    path = scene / PLY
    header = path.read_bytes().split(b"end_header\n")[0]
    lines = [
        b"element vertex 0" if line.startswith(b"element vertex") else line
        for line in header.split(b"\n")
    ]
    path.write_bytes(b"\n".join(lines) + b"end_header\n")


def corrupt_truncated(scene: Path) -> None:
    path = scene / PLY
    path.write_bytes(path.read_bytes()[:-1000])


def corrupt_promise(scene: Path) -> None:
    path = scene / PLY
    data = path.read_bytes()
    count = data.split(b"element vertex ")[1].split(b"\n")[0]
    path.write_bytes(data.replace(b"element vertex " + count, b"element vertex 99999999999"))


def corrupt_missing_picture(scene: Path) -> None:
    sorted((scene / "images").glob("*.png"))[0].unlink()


def corrupt_queries(scene: Path) -> None:
    (scene / "queries.json").write_text("[{]")


@pytest.mark.parametrize(
    ("corrupt", "expected"),
    [
        (corrupt_missing_column, [PLY, "opacity"]),
        (corrupt_nan, [PLY, "finite"]),
        (corrupt_empty, [PLY, "no Gaussian"]),
        (corrupt_truncated, [PLY]),
        (corrupt_promise, [PLY, "99999999999"]),
        (corrupt_missing_picture, ["images"]),
        (corrupt_queries, ["queries.json"]),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_a_broken_scene_exits_with_2_and_leaves_nothing_behind(
    gvr, home, tmp_path, two_boxes_folder, prefect_server, corrupt, expected
) -> None:
    mine = tmp_path / "mine"
    shutil.copytree(two_boxes_folder, mine)
    corrupt(mine / "two-boxes")
    suite = str(suite_file(tmp_path, mine))
    code, _, err = gvr("run", suite, "--quiet", "--no-mlflow")
    assert code == 2
    flat = err.replace("\n", "")
    for part in expected:
        assert part in flat
    assert "Traceback" not in err
    assert not stored_files(home)
    (folder,) = (home / "results").iterdir()
    (scene,) = json.loads((folder / "result.json").read_text())["scenes"]
    assert scene["status"] == "failed"


def test_a_terminated_run_takes_its_server_with_it(home, tmp_path, two_boxes_folder) -> None:
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PREFECT_")}
    environment |= {"GVR_HOME": str(home), "HOME": str(tmp_path)}
    suite = str(suite_file(tmp_path, two_boxes_folder))
    process = psutil.Popen(
        [sys.executable, "-m", "flows", "run", suite, "--quiet", "--no-mlflow"],
        cwd=REPOSITORY,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 120
    servers: list[psutil.Process] = []
    while not servers and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.2)
        servers = [
            p for p in process.children(recursive=True) if "tasks.prefect_serve" in p.cmdline()
        ]
    assert servers
    time.sleep(2)  # well into the start of the server
    process.terminate()
    assert process.wait(timeout=60) == 128 + signal.SIGTERM
    _, alive = psutil.wait_procs(servers, timeout=30)
    assert not alive
