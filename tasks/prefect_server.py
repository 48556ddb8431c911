"""The project's own Prefect server on 127.0.0.1: one a home, shared by all commands that run.

Under the home lie::

    server.json   which process it is, and where it listens
    server.log    what it wrote
    start.lock    held by whoever starts or stops a server, or is about to use one
    users.lock    held, shared, by every process that uses the server

The first user starts it and the last one stops it. The kernel lets go of a killed user's lock, and
a server without users ends by itself (`tasks.prefect_serve`).
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import httpx
import psutil

from gvr_core.atomic import atomic_write
from gvr_core.errors import StoreError
from gvr_core.locks import file_lock
from tasks.prefect_drain import drain, settle
from tasks.prefect_serve import HOST

START_TIMEOUT_SECONDS = 120
"""The server takes 7-18 s to start on two cores, 40 s on busy ones; Prefect's limit is 20 s."""

STOP_SECONDS = 10.0
_ANSWER_SECONDS = 30.0
"""A busy server with a live process is waited for this long before it counts as hung."""


@dataclass(frozen=True)
class ServerRecord:
    """Which process serves a home."""

    pid: int
    started: float
    """Start of the process, seconds since the epoch: a number that was given to another process
    meanwhile does not pass for the server."""
    url: str
    """Of its API."""

    def process(self) -> psutil.Process | None:
        """The server's process; None where it is gone."""
        try:
            process = psutil.Process(self.pid)
            same = process.create_time() == self.started
            return process if same and process.status() != psutil.STATUS_ZOMBIE else None
        except psutil.Error:
            return None


def read_record(home: Path) -> ServerRecord | None:
    """The server that a home names; None where it names none, or nothing readable."""
    try:
        return ServerRecord(**json.loads((home / "server.json").read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


@contextmanager
def local_server(home: Path, meanwhile: Callable[[], object] | None = None) -> Iterator[str]:
    """Use the home's server, and start it where none runs; yields the URL of its API.

    Leaving stops the server if nobody else uses it.

    Args:
        home: Of Prefect.
        meanwhile: Called while a server starts, which takes seconds; not where one runs already.

    Raises:
        StoreError: The server does not start.
    """
    from prefect.settings import temporary_settings

    with ExitStack() as held:
        with file_lock(home / "start.lock", timeout=2 * START_TIMEOUT_SECONDS):
            # What such a server shows as running was killed.
            alone_with_history = _is_free(home / "users.lock") and _has_history()
            held.enter_context(file_lock(home / "users.lock", shared=True))
            url = _living(home) or _start(home, meanwhile)
        with temporary_settings({"api.url": url}):
            if alone_with_history:
                _end_lost_runs()
            try:
                yield url
            finally:
                drain()
                settle()
                with file_lock(home / "start.lock", timeout=2 * START_TIMEOUT_SECONDS):
                    held.close()
                    if _is_free(home / "users.lock"):
                        _stop(home)


@contextmanager
def joined_server(home: Path, url: str) -> Iterator[None]:
    """Count among the users of the home's server, where that is the one at ``url``.

    For processes that were told its address: it then outlives those who told them.
    """
    record = read_record(home)
    if record is None or record.url != url:
        yield
        return
    with file_lock(home / "users.lock", shared=True):
        yield


def _is_free(lock: Path) -> bool:
    try:
        with file_lock(lock, timeout=0):
            return True
    except StoreError:
        return False


def _living(home: Path) -> str | None:
    """The URL of the home's server, if it answers; one that hangs is ended."""
    record = read_record(home)
    if record is None:
        return None
    deadline = time.monotonic() + _ANSWER_SECONDS
    while record.process() is not None and time.monotonic() < deadline:
        if _answers(record.url):
            return record.url
        time.sleep(0.2)
    _stop(home)
    return None


def _answers(url: str) -> bool:
    try:
        # A proxy knows nothing of this machine's loopback, and plain HTTP needs no certificates,
        # which take longer to load than the answer.
        with httpx.Client(trust_env=False, verify=False, timeout=5) as client:
            return client.get(f"{url}/health").status_code == 200
    except httpx.HTTPError:
        return False


def _start(home: Path, meanwhile: Callable[[], object] | None) -> str:
    from prefect.settings import get_current_settings

    port = _free_port()
    settings = get_current_settings().to_environment_variables(exclude_unset=True)
    environment = {
        **os.environ,
        **settings,
        "PREFECT_UI_ENABLED": "0",
        "PREFECT__SERVER_FINAL": "1",
    }
    environment.pop("PREFECT_API_URL", None)
    root = Path(__file__).resolve().parent.parent
    environment["PYTHONPATH"] = os.pathsep.join(
        part for part in (str(root), os.environ.get("PYTHONPATH")) if part
    )
    with (home / "server.log").open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "tasks.prefect_serve", str(home), str(port)],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            # Ctrl-C reaches its users alone, who still have states to send to it.
            start_new_session=True,
            env=environment,
        )
    url = f"http://{HOST}:{port}/api"
    try:
        record = ServerRecord(process.pid, psutil.Process(process.pid).create_time(), url)
        with atomic_write(home / "server.json") as stream:
            stream.write(json.dumps(asdict(record)).encode())
        if meanwhile is not None:
            meanwhile()
        _await_answer(process, url, home)
    except BaseException:
        process.kill()
        process.wait()
        raise
    _started[process.pid] = process
    return url


def _await_answer(process: subprocess.Popen[bytes], url: str, home: Path) -> None:
    deadline = time.monotonic() + START_TIMEOUT_SECONDS
    while not _answers(url):
        code = process.poll()
        if code is None and time.monotonic() < deadline:
            time.sleep(0.1)
            continue
        log = home / "server.log"
        text = log.read_text(encoding="utf-8", errors="replace").strip()[-1000:]
        how = "does not answer" if code is None else f"exited with code {code}"
        raise StoreError(
            f"no Prefect server could be started with home {home}: it {how}:"
            f" {text or 'it wrote nothing'} (all of it: {log})"
        )


_started: dict[int, subprocess.Popen[bytes]] = {}
"""Servers that this process started, which stay its children until they are waited for."""


def _stop(home: Path) -> None:
    """End the home's server: politely, and after a while by force."""
    record = read_record(home)
    process = record and record.process()
    if process:
        with suppress(psutil.Error):
            process.terminate()
            _await_end(process)
    if record and record.pid in _started:
        _started.pop(record.pid).wait()
    (home / "server.json").unlink(missing_ok=True)


def _await_end(process: psutil.Process) -> None:
    deadline = time.monotonic() + STOP_SECONDS
    # Not Process.wait: to those who are not its parent, a server that nobody waited for lives on.
    while process.is_running() and process.status() != psutil.STATUS_ZOMBIE:
        if time.monotonic() > deadline:
            process.kill()
        time.sleep(0.05)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def _has_history() -> bool:
    """Whether the server's database may hold runs of before: False for a file yet to be made."""
    from prefect.settings import get_current_settings
    from sqlalchemy.engine import make_url

    address = get_current_settings().server.database.connection_url
    if address is None:
        return True
    url = make_url(address.get_secret_value())
    return not url.drivername.startswith("sqlite") or Path(url.database or "").exists()


def _end_lost_runs() -> None:
    """End the runs that are shown as running, at a server that nobody else uses.

    Whatever ran them was killed.
    """
    from prefect.client.orchestration import get_client
    from prefect.client.schemas.filters import (
        FlowRunFilter,
        FlowRunFilterState,
        FlowRunFilterStateType,
    )
    from prefect.client.schemas.objects import StateType
    from prefect.states import Crashed

    going = [StateType.PENDING, StateType.RUNNING, StateType.CANCELLING]
    lost = FlowRunFilter(state=FlowRunFilterState(type=FlowRunFilterStateType(any_=going)))
    with get_client(sync_client=True) as client:
        for run in client.read_flow_runs(flow_run_filter=lost):
            ended = Crashed(message="the process that ran it is gone")
            client.set_flow_run_state(run.id, ended, force=True)
