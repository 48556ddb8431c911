"""What is still on its way to a Prefect server: states of task runs and lines of logs."""

from __future__ import annotations

import inspect
import time
from collections import deque
from uuid import UUID

FLUSH_SECONDS = 1.0
"""How long the server collects states of task runs before it writes them down. Prefect 3.8 takes
the whole number below: half a second would be none, and an idle server that uses 0.65 of a core."""

_SETTLE_SECONDS = 20.0

_latest_task_runs: deque[UUID] = deque(maxlen=100)
_noted = 0.0
"""When the latest was noted."""


def note_task_run(task_run: UUID | None) -> None:
    """Remember a finished task run, so that the server is not stopped before it knows of it."""
    global _noted
    if task_run is not None:
        _latest_task_runs.append(task_run)
        _noted = time.monotonic()


def take_task_runs() -> list[UUID]:
    """The latest finished task runs of this process, for another one to wait for."""
    taken = list(_latest_task_runs)
    _latest_task_runs.clear()
    return taken


def settle() -> None:
    """Wait until the server has written down the latest task runs.

    It collects states in batches and loses those of the last half second when it is stopped on a
    busy machine. Gives up after a while: what is lost is in the display only.
    """
    from prefect.client.orchestration import get_client
    from prefect.client.schemas.filters import TaskRunFilter, TaskRunFilterId

    wanted = take_task_runs()
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
    time.sleep(max(0.0, _noted + FLUSH_SECONDS - time.monotonic()))


def drain() -> None:
    """Send what this process still holds: the last states and log lines."""
    from prefect.events.worker import EventsWorker
    from prefect.logging.handlers import APILogWorker
    from prefect.utilities.asyncutils import run_coro_as_sync

    async def send() -> None:
        for call in (lambda: APILogWorker.instance().drain(), EventsWorker.drain_all):
            try:
                result = call()
                if inspect.isawaitable(result):
                    await result
            except RuntimeError:
                continue  # never started

    run_coro_as_sync(send())
