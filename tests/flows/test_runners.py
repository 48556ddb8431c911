"""The same record from every runner; a death, a hang and a bad scene cost that scene alone."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
from prefect import get_client
from prefect.client.schemas.filters import FlowRunFilter, FlowRunFilterTags

from benchmarks.scale_out import make_scenes, scale_suite
from flows.benchmark import BenchmarkOutcome, run_benchmark
from flows.run_config import RunConfig
from gvr_core.errors import ConfigError
from reports.same_record import differences
from tasks.prefect_runtime import PrefectRuntime, prefect_runtime
from tasks.store import Store

Bench = Callable[[Path, RunConfig], BenchmarkOutcome]


@pytest.fixture(scope="session")
def small_scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_scenes(tmp_path_factory.mktemp("scale") / "scenes", 4)


@pytest.fixture
def bench(prefect_server: PrefectRuntime, tmp_path: Path) -> Bench:
    """Run scenes on a store of that run alone."""
    runs = iter(range(100))

    def run(scenes: Path, config: RunConfig) -> BenchmarkOutcome:
        folder = tmp_path / f"run{next(runs)}"
        with prefect_runtime(Store(folder / "store"), home=prefect_server.home, isolated=True):
            suite = scale_suite(scenes, config)
            return run_benchmark(suite, str(folder / "store"), str(folder / "results"))

    return run


def attempts(outcome: BenchmarkOutcome) -> list[int]:
    return [scene.attempts for scene in outcome.result.scenes]


def scene_states(outcome: BenchmarkOutcome) -> dict[str, tuple[str, str]]:
    """Name of a scene's flow run -> its state and message, as the server has them."""
    tagged = FlowRunFilter(tags=FlowRunFilterTags(all_=[outcome.result.run_id]))
    with get_client(sync_client=True) as client:
        runs = client.read_flow_runs(flow_run_filter=tagged)
    return {
        run.name.rpartition("/")[2]: (run.state.name or "", run.state.message or "")
        for run in runs
        if run.state is not None
    }


@contextmanager
def first_worker_gets(number: signal.Signals) -> Iterator[list[int]]:
    """Send a signal to the first scene process that appears; yields the processes that got it."""
    hit: list[int] = []
    over = threading.Event()

    def send() -> None:
        while not hit and not over.wait(0.05):
            for child in psutil.Process().children(recursive=True):
                try:
                    if "flows.scene_worker" in child.cmdline() and child.num_threads() > 3:
                        os.kill(child.pid, number)
                        hit.append(child.pid)
                        return
                except (psutil.Error, OSError):
                    continue

    sender = threading.Thread(target=send)
    sender.start()
    try:
        yield hit
    finally:
        over.set()
        sender.join()


def test_threads_give_the_record_that_one_thread_gives(bench: Bench, small_scenes: Path) -> None:
    serial = bench(small_scenes, RunConfig())
    threads = bench(small_scenes, RunConfig(runner="threads", workers=3, scenes_in_flight=2))
    assert differences(serial.folder, threads.folder) == []
    assert [s.scene for s in serial.result.scenes] == [f"scene_{i:04d}" for i in range(4)]
    assert len(serial.rows) == len(threads.rows) > 0 and not serial.failed
    # That a difference would be seen:
    rows = (threads.folder / "rows.jsonl").read_bytes()
    (threads.folder / "pictures" / "more.png").write_bytes(rows)
    assert differences(serial.folder, threads.folder) == ["pictures/more.png"]


def test_bad_input_is_not_tried_again_and_the_others_go_on(
    bench: Bench, small_scenes: Path, tmp_path: Path
) -> None:
    scenes = make_scenes(tmp_path / "scenes", 3)
    (scenes / "scene_0001" / "queries.json").write_text("[{")
    outcome = bench(scenes, RunConfig(retries=3, retry_delay_seconds=0))
    assert [s.status for s in outcome.result.scenes] == ["completed", "failed", "completed"]
    assert attempts(outcome) == [1, 1, 1] and outcome.bad_input
    states = scene_states(outcome)
    assert states["scene_0000"][0] == states["scene_0002"][0] == "Completed"
    name, message = states["scene_0001"]
    assert name == "Failed" and message.startswith("gvr-paper: ") and "queries.json" in message
    with get_client(sync_client=True) as client:
        (whole,) = [r for r in client.read_flow_runs() if r.name == outcome.result.run_id]
    assert whole.state.name == "Failed" and "scene_0001" in whole.state.message
    assert (outcome.folder / "result.json").exists()


def test_a_killed_process_costs_its_scene_a_try(bench: Bench, small_scenes: Path) -> None:
    config = RunConfig(runner="processes", workers=2, retry_delay_seconds=0)
    with first_worker_gets(signal.SIGKILL) as hit:
        outcome = bench(small_scenes, config)
    assert len(hit) == 1 and not outcome.failed
    assert sorted(attempts(outcome)) == [1, 1, 1, 2]
    assert differences(bench(small_scenes, RunConfig()).folder, outcome.folder) == []
    states = scene_states(outcome)
    ((first, message),) = [state for state in states.values() if state[0] != "Completed"]
    assert first == "Failed" and "SIGKILL" in message
    assert sum("try 2" in name for name in states) == 1


@pytest.mark.slow
def test_a_hung_scene_is_ended_and_named_and_the_others_go_on(
    bench: Bench, small_scenes: Path
) -> None:
    config = RunConfig(runner="processes", workers=2, retries=0, scene_seconds=40)
    with first_worker_gets(signal.SIGSTOP) as hit:
        outcome = bench(small_scenes, config)
    assert len(hit) == 1
    assert sorted(s.status for s in outcome.result.scenes) == ["completed"] * 3 + ["failed"]
    (failure,) = outcome.failed
    assert "SceneLost: " in failure and "took longer than" in failure
    assert not psutil.pid_exists(hit[0])


@pytest.mark.slow
def test_forty_scenes_on_dask_give_the_record_that_one_process_gives(
    bench: Bench, tmp_path: Path
) -> None:
    scenes = make_scenes(tmp_path / "scenes", 40)
    serial = bench(scenes, RunConfig())
    dask = bench(scenes, RunConfig(runner="dask", workers=2))
    assert not serial.failed and len(serial.result.scenes) == 40
    assert differences(serial.folder, dask.folder) == []
    assert (serial.folder / "rows.jsonl").read_bytes() == (dask.folder / "rows.jsonl").read_bytes()


@pytest.mark.slow
def test_a_killed_dask_worker_costs_its_scene_a_try(bench: Bench, small_scenes: Path) -> None:
    killed: list[int] = []
    over = threading.Event()

    def kill() -> None:
        while not killed and not over.wait(0.05):
            for child in psutil.Process().children(recursive=True):
                try:
                    busy = child.cpu_times().user > 2 and "spawn_main" in " ".join(child.cmdline())
                    if busy:
                        child.kill()
                        killed.append(child.pid)
                        return
                except psutil.Error:
                    continue

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        outcome = bench(
            small_scenes, RunConfig(runner="dask", workers=2, retries=2, retry_delay_seconds=0)
        )
    finally:
        over.set()
        thread.join()
    assert len(killed) == 1 and not outcome.failed
    assert differences(bench(small_scenes, RunConfig()).folder, outcome.folder) == []


def test_a_scheduler_that_does_not_answer_is_bad_input(
    bench: Bench, small_scenes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flows.runners.CONNECT_SECONDS", 1)
    with pytest.raises(ConfigError, match=r"scheduler tcp://127\.0\.0\.1:9 does not answer"):
        bench(small_scenes, RunConfig(runner="dask", dask_scheduler="tcp://127.0.0.1:9"))


@pytest.mark.slow
def test_a_killed_run_leaves_no_process_behind(small_scenes: Path, tmp_path: Path) -> None:
    import subprocess
    import sys

    code = (
        "import sys\n"
        "from benchmarks.scale_out import scale_suite\n"
        "from flows.run_config import RunConfig\n"
        "from pathlib import Path\n"
        "from flows.benchmark import run_benchmark\n"
        "from tasks.prefect_runtime import prefect_runtime\n"
        "from tasks.store import Store\n"
        "with prefect_runtime(Store('store'), home='prefect', isolated=True):\n"
        "    suite = scale_suite(Path(sys.argv[1]), RunConfig(runner='processes', workers=2))\n"
        "    run_benchmark(suite, 'store', 'results')\n"
    )
    root = Path(__file__).resolve().parents[2]
    run = subprocess.Popen(
        [sys.executable, "-c", code, str(small_scenes)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(root)},
    )
    deadline = time.monotonic() + 240
    started: list[psutil.Process] = []
    while len(started) < 2:
        assert time.monotonic() < deadline and run.poll() is None
        children = psutil.Process(run.pid).children(recursive=True)
        started = [c for c in children if "flows.scene_worker" in " ".join(c.cmdline())]
        time.sleep(0.1)
    everything = psutil.Process(run.pid).children(recursive=True)
    run.kill()
    run.wait()
    gone, alive = psutil.wait_procs(everything, timeout=60)
    assert alive == [] and len(gone) >= 3
