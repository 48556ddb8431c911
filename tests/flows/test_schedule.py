"""Schedules on a real Prefect server: ``gvr schedule``, and a worker over ``prefect.yaml``."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest

from benchmarks.scale_out import make_scenes
from reports.result_io import list_results, read_result

pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).resolve().parents[2]
SUITE = """
name = "{name}"
[[datasets]]
name = "folder:{scenes}"
[models]
segmenter = "oracle"
encoder = "oracle"
text_segmenter = "oracle"
[run]
retries = 0
"""
FINAL = ("COMPLETED", "FAILED", "CRASHED", "CANCELLED")


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """That of a user who never used Prefect, with the project's places in this test's folder."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT", "GVR_", "MLFLOW"))}
    kept.pop("DO_NOT_TRACK", None)
    (tmp_path / "user").mkdir()
    return kept | {
        "HOME": str(tmp_path / "user"),
        "GVR_HOME": str(tmp_path / "home"),
        "PYTHONPATH": str(REPOSITORY),
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
    }


def write_suite(folder: Path, name: str, scenes: int = 2, broken: bool = False) -> Path:
    made = make_scenes(folder / f"{name}_scenes", scenes)
    if broken:
        (made / "scene_0001" / "queries.json").write_text("[{")
    path = folder / f"{name}.toml"
    path.write_text(SUITE.format(name=name, scenes=made))
    return path


@contextmanager
def running(
    arguments: list[str], environment: dict[str, str], folder: Path, name: str
) -> Iterator[subprocess.Popen[bytes]]:
    """A command, interrupted at the end as Ctrl-C does it."""
    with (folder / f"{name}.log").open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", *arguments],
            cwd=REPOSITORY,
            env=environment,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(240)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        print((folder / f"{name}.log").read_text()[-3000:])


def poll(what: Callable[[], Any], seconds: float, process: subprocess.Popen[bytes]) -> Any:
    deadline = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < deadline, "waited in vain"
        assert process.poll() is None, "the command ended"
        time.sleep(0.5)
    return found


def runs_of(url: str, flow: str) -> list[dict[str, Any]]:
    """The flow runs of a flow that have begun, oldest first."""
    body = {"flows": {"name": {"any_": [flow]}}, "sort": "EXPECTED_START_TIME_ASC"}
    answer = httpx.post(f"{url}/flow_runs/filter", json=body, trust_env=False, timeout=30)
    return [run for run in answer.json() if run["start_time"]]


def ended(url: str, count: int, state: str = "Completed") -> list[dict[str, Any]]:
    """The nightly runs, once so many have ended in a state; none before."""
    over = [run for run in runs_of(url, "nightly") if run["state_type"] in FINAL]
    return over if sum(run["state_name"] == state for run in over) >= count else []


def server_url(home: Path) -> str | None:
    from tasks.prefect_server import _answers, read_record

    record = read_record(home / "prefect")
    return record.url if record is not None and _answers(record.url) else None


def test_a_schedule_runs_again_and_again(tmp_path: Path, environment: dict[str, str]) -> None:
    suite = write_suite(tmp_path, "often")
    arguments = ["flows", "schedule", str(suite), "--interval", "25s"]
    with running(arguments, environment, tmp_path, "schedule") as process:
        url = poll(lambda: server_url(tmp_path / "home"), 240, process)
        runs = poll(lambda: ended(url, 2), 600, process)
        # On a busy machine one is due while the one before goes on: that one is cancelled.
        assert {run["state_name"] for run in runs} <= {"Completed", "Cancelled"}
        due = [seconds(run["expected_start_time"]) for run in runs]
        assert {round(time - due[0]) % 25 for time in due} == {0}
        artifacts = httpx.post(f"{url}/artifacts/filter", json={}, trust_env=False).json()
        assert {a["key"] for a in artifacts if a["key"]} == {"result-often"}
        everything = psutil.Process(process.pid).children(recursive=True)
    assert process.returncode == 0
    results = list_results(tmp_path / "home" / "results")
    assert len(results) >= 2
    first, second = (read_result(folder)[0] for folder in results[:2])
    assert [s.status for s in first.scenes] == ["completed"] * 2
    assert {stage.state for s in first.scenes for stage in s.stages} == {"computed"}
    assert {stage.state for s in second.scenes for stage in s.stages} == {"cached"}
    assert first.started_by == "schedule"
    assert (tmp_path / "home" / "mlflow").is_dir()
    assert psutil.wait_procs(everything, timeout=30)[1] == []


def test_missed_runs_are_not_made_up_for(tmp_path: Path, environment: dict[str, str]) -> None:
    suite = write_suite(tmp_path, "missed", scenes=1)
    arguments = ["flows", "schedule", str(suite), "--interval", "10s", "--no-mlflow"]
    with running(arguments, environment, tmp_path, "killed") as process:
        url = poll(lambda: server_url(tmp_path / "home"), 240, process)
        poll(lambda: planned(url), 240, process)
        process.kill()
        process.wait()
    time.sleep(15)  # so long that runs are missed
    arguments[4] = "1h"
    with running(arguments, environment, tmp_path, "again") as process:
        url = poll(lambda: server_url(tmp_path / "home"), 240, process)
        poll(lambda: len(planned(url)) and min(planned(url)) > time.time() - 5, 240, process)


def planned(url: str) -> list[float]:
    """When the runs are due that have not begun."""
    body = {"flow_runs": {"state": {"type": {"any_": ["SCHEDULED"]}}}}
    answer = httpx.post(f"{url}/flow_runs/filter", json=body, trust_env=False, timeout=30)
    return [seconds(run["expected_start_time"]) for run in answer.json()]


def test_a_failing_scene_makes_the_run_failed_and_the_others_go_on(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    suite = write_suite(tmp_path, "broken", scenes=3, broken=True)
    arguments = ["flows", "schedule", str(suite), "--interval", "15s", "--no-mlflow"]
    with running(arguments, environment, tmp_path, "schedule") as process:
        url = poll(lambda: server_url(tmp_path / "home"), 240, process)
        runs = poll(lambda: ended(url, 1, "Failed"), 300, process)
        (run, *_) = [run for run in runs if run["state_name"] == "Failed"]
        assert "scene_0001" in run["state"]["message"]
        states = {r["name"].rpartition("/")[2]: r["state_name"] for r in runs_of(url, "scene")[:3]}
    assert states == {"scene_0000": "Completed", "scene_0001": "Failed", "scene_0002": "Completed"}
    folder = list_results(tmp_path / "home" / "results")[0]
    statuses = [s.status for s in read_result(folder)[0].scenes]
    assert statuses == ["completed", "failed", "completed"]


def test_a_worker_runs_what_prefect_yaml_deploys(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    suite = write_suite(tmp_path, "pool")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    url = f"http://127.0.0.1:{port}/api"
    environment |= {
        "PREFECT_HOME": str(tmp_path / "prefect"),
        "PREFECT_API_URL": url,
        "GVR_PROJECT": str(REPOSITORY),
        "DO_NOT_TRACK": "1",
    }
    project = tmp_path / "project"
    project.mkdir()
    shutil.copy(REPOSITORY / "prefect.yaml", project)
    (project / "flows").symlink_to(REPOSITORY / "flows")

    def prefect(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "prefect", "--no-prompt", *arguments],
            cwd=project,
            env=environment,
            capture_output=True,
            text=True,
            timeout=200,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    server = ["prefect", "server", "start", "--host", "127.0.0.1", "--port", port, "--no-ui"]
    with running(server, environment, tmp_path, "server") as process:
        poll(lambda: answers(f"{url}/health"), 240, process)
        prefect("work-pool", "create", "gvr", "--type", "process")
        parameter = f"suite={suite}"
        prefect("deploy", "-n", "nightly", "--interval", "30", "--param", parameter)
        worker = ["prefect", "worker", "start", "--pool", "gvr"]
        with running(worker, environment, tmp_path, "worker") as working:
            runs = poll(lambda: ended(url, 2), 400, working)
    assert {run["state_name"] for run in runs} <= {"Completed", "Cancelled"}
    results = list_results(tmp_path / "home" / "results")
    assert len(results) >= 2
    assert all(not scene.error for scene in read_result(results[0])[0].scenes)


def answers(url: str) -> bool:
    try:
        return httpx.get(url, trust_env=False, timeout=5).status_code == 200
    except httpx.HTTPError:
        return False


def seconds(text: str) -> float:
    return datetime.fromisoformat(text.replace("Z", "+00:00")).timestamp()
