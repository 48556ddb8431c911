"""One server a home: shared, stopped by the last, and never left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from tasks.prefect_server import ServerRecord, read_record

REPOSITORY = Path(__file__).resolve().parents[2]

USER = """
import sys, time
from pathlib import Path
from prefect import flow
from tasks.prefect_runtime import prefect_runtime
from tasks.store import Store

until = Path(sys.argv[2])

@flow(name="waiting")
def waiting():
    print("running", flush=True)
    while not until.exists():
        time.sleep(0.05)

starts = []
meanwhile = lambda: starts.append(1)
with prefect_runtime(Store("store"), home=sys.argv[1], meanwhile=meanwhile) as runtime:
    print(runtime.api_url, flush=True)
    waiting()
print(f"done, {len(starts)} started", flush=True)
"""


class User:
    """A command that uses the home's server until its file appears."""

    def __init__(self, folder: Path, name: str) -> None:
        self.until = folder / name
        environment = {k: v for k, v in os.environ.items() if not k.startswith("PREFECT")}
        self.process = subprocess.Popen(
            [sys.executable, "-c", USER, str(folder / "prefect"), str(self.until)],
            cwd=folder,
            env=environment | {"HOME": str(folder), "PYTHONPATH": str(REPOSITORY)},
            stdout=subprocess.PIPE,
            text=True,
        )

    def says(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()

    def leave(self) -> int:
        """How many servers it has started."""
        self.until.touch()
        words = self.says().split()
        assert words[0] == "done,"
        assert self.process.wait(60) == 0
        return int(words[1])

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(10)


@pytest.fixture
def user(tmp_path: Path) -> Iterator[Callable[[str], User]]:
    users: list[User] = []

    def start(name: str) -> User:
        users.append(User(tmp_path, name))
        return users[-1]

    yield start
    for each in users:
        if each.process.poll() is None:
            each.kill()
        each.process.stdout.close()
    record = read_record(tmp_path / "prefect")
    if record is not None:
        wait_until(lambda: record.process() is None, 30)


def wait_until(condition: Callable[[], bool], seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.1)


def servers(home: Path) -> list[psutil.Process]:
    """All processes that serve a home."""
    found = []
    for process in psutil.process_iter(["cmdline"]):
        line = process.info["cmdline"] or []
        if "tasks.prefect_serve" in line and str(home) in line:
            found.append(process)
    return found


def test_two_commands_at_once_share_a_server_and_the_last_one_stops_it(tmp_path, user) -> None:
    home = tmp_path / "prefect"
    first, second = user("first"), user("second")
    url = first.says()
    assert second.says() == url
    assert first.says() == second.says() == "running"
    assert len(servers(home)) == 1
    started = first.leave()
    assert len(servers(home)) == 1
    assert started + second.leave() == 1
    assert servers(home) == [] and read_record(home) is None


@pytest.mark.slow
def test_a_killed_command_leaves_no_server_behind(tmp_path, user) -> None:
    home = tmp_path / "prefect"
    first = user("first")
    first.says(), first.says()
    record = read_record(home)
    first.kill()
    wait_until(lambda: record.process() is None, 20)
    assert servers(home) == []

    # The next one starts anew, and ends the run that is shown as running.
    second = user("second")
    second.says(), second.says()
    assert flow_states(read_record(home)) == ["Crashed", "Running"]
    # One that comes before the orphan is gone takes it over.
    second.kill()
    third = user("third")
    third.says(), third.says()
    assert len(servers(home)) == 1
    third.leave()
    assert servers(home) == []


@pytest.mark.slow
def test_a_dead_or_hung_server_is_replaced(tmp_path, user, monkeypatch) -> None:
    home = tmp_path / "prefect"
    first = user("first")
    first.says(), first.says()
    dead = read_record(home)
    dead.process().kill()
    first.kill()
    second = user("second")
    second.says(), second.says()
    hung = read_record(home)
    assert hung.pid != dead.pid
    hung.process().send_signal(signal.SIGSTOP)
    second.kill()
    third = user("third")
    assert third.says() != hung.url
    assert hung.process() is None and len(servers(home)) == 1
    third.says()
    third.leave()


def flow_states(record: ServerRecord) -> list[str]:
    """States of all flow runs that a server knows, in alphabetical order."""
    import httpx

    runs = httpx.post(f"{record.url}/flow_runs/filter", json={}, trust_env=False).json()
    return sorted(run["state"]["name"] for run in runs)
