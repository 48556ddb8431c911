"""A Prefect server of our own on 127.0.0.1: started before flows, stopped when it knows all."""

from __future__ import annotations

import inspect
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import UUID

from gvr_core.errors import StoreError
from gvr_core.locks import file_lock

START_TIMEOUT_SECONDS = 120
"""The server takes 7-18 s to start on two cores, 40 s on busy ones; Prefect's limit is 20 s."""

FLUSH_SECONDS = 1.0
"""How long the server collects states of task runs before it writes them down. Prefect 3.8 takes
the whole number below: half a second would be none, and an idle server that uses 0.65 of a core."""

_SETTLE_SECONDS = 20.0


@contextmanager
def local_server(home: Path) -> Iterator[str]:
    """Run a server on 127.0.0.1; yields the URL of its API."""
    from prefect.server.api.server import SubprocessASGIServer
    from prefect.settings import temporary_settings

    server = SubprocessASGIServer()
    started = not server.running
    try:
        # Two servers that make the same new database at once crash in its migration.
        with file_lock(home / "start.lock", timeout=2 * START_TIMEOUT_SECONDS):
            server.start(timeout=START_TIMEOUT_SECONDS)
    except RuntimeError as error:
        raise StoreError(f"no Prefect server could be started with home {home}: {error}") from error
    with temporary_settings({"api.url": server.api_url}):
        try:
            yield server.api_url
        finally:
            if started:
                _drain()
                _settle()
                server.stop()


_latest_task_runs: deque[UUID] = deque(maxlen=100)


def note_task_run(task_run: UUID | None) -> None:
    """Remember a finished task run, so that the server is not stopped before it knows of it."""
    if task_run is not None:
        _latest_task_runs.append(task_run)


def _settle() -> None:
    """Wait until the server has written down the latest task runs.

    It collects states in batches and loses those of the last half second when it is stopped on a
    busy machine. Gives up after a while: what is lost is in the display only.
    """
    from prefect.client.orchestration import get_client
    from prefect.client.schemas.filters import TaskRunFilter, TaskRunFilterId

    wanted = list(_latest_task_runs)
    _latest_task_runs.clear()
    if not wanted:
        return
    deadline = time.monotonic() + _SETTLE_SECONDS
    these = TaskRunFilter(id=TaskRunFilterId(any_=wanted))
    with get_client(sync_client=True) as client:
        while time.monotonic() < deadline:
            shown = client.read_task_runs(task_run_filter=these)
            if sum(run.state is not None and run.state.is_final() for run in shown) == len(wanted):
                break
            time.sleep(0.1)
    # Task runs of other processes came through this one, ahead of or among the latest.
    time.sleep(FLUSH_SECONDS)


def _drain() -> None:
    """Send what is still on its way to the server: the last states and log lines."""
    from prefect.events.worker import EventsWorker
    from prefect.logging.handlers import APILogWorker
    from prefect.utilities.asyncutils import run_coro_as_sync

    async def drain() -> None:
        for call in (lambda: APILogWorker.instance().drain(), EventsWorker.drain_all):
            try:
                result = call()
                if inspect.isawaitable(result):
                    await result
            except RuntimeError:
                continue  # never started

    run_coro_as_sync(drain())
