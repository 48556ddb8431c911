"""Processes that compute scenes, from the side of whoever hands the scenes out.

A process makes one try after the other; JSON lines go to its standard input, and come back
through a pipe of its own. One that dies or takes too long takes only its own scene with it.
"""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from uuid import UUID

from flows.scene_outcome import Listener, SceneOutcome
from flows.scene_try import SceneTry
from gvr_core.errors import GVRError
from gvr_core.threads import thread_limits
from tasks.prefect_drain import note_task_run

START_SECONDS = 300.0
"""It takes 5 to 10 s to start on two cores, and more on busy ones."""
END_SECONDS = 20.0
"""A process that is told to end sends its last states to the Prefect server first."""

_ROOT = Path(__file__).resolve().parent.parent


class SceneLost(GVRError):
    """A scene's process died, or was ended because it took too long."""


class SceneProcess:
    """A process that makes tries of scenes.

    Args:
        store: Where the artifact store is.
        threads: Threads that it may compute with.
    """

    def __init__(self, store: str, threads: int) -> None:
        from prefect.settings import get_current_settings

        self.serves = (store, threads, str(get_current_settings().api.url))
        """What it was started for."""
        answers, theirs = os.pipe()
        settings = get_current_settings().to_environment_variables(exclude_unset=True)
        path = os.pathsep.join(filter(None, (str(_ROOT), os.environ.get("PYTHONPATH"))))
        self._process = subprocess.Popen(
            [sys.executable, "-m", "flows.scene_worker", str(theirs), store],
            stdin=subprocess.PIPE,
            stdout=2,  # whatever a library prints is no answer of ours
            pass_fds=(theirs,),
            # Ctrl-C reaches the run alone, which ends its processes.
            start_new_session=True,
            env={**os.environ, **settings, **thread_limits(threads), "PYTHONPATH": path},
        )
        os.close(theirs)
        assert self._process.stdin is not None  # it is a pipe
        self._orders = self._process.stdin
        self._answers = answers
        self._buffer = b""
        self._ready = False

    @property
    def pid(self) -> int:
        """Its number."""
        return self._process.pid

    def run(self, order: SceneTry, listener: Listener) -> None:
        """Make a try in the process.

        Raises:
            SceneLost: The process died, or took longer than ``order.scene_seconds``.
        """
        if not self._ready:  # the time limit is for the scene alone
            self._next(time.monotonic() + START_SECONDS, "to start", START_SECONDS)
            self._ready = True
        deadline = None
        if order.scene_seconds is not None:
            deadline = time.monotonic() + order.scene_seconds
        try:
            self._orders.write(order.model_dump_json().encode() + b"\n")
            self._orders.flush()
        except OSError as error:
            raise self._died() from error
        while True:
            answer = self._next(deadline, "", order.scene_seconds or 0)
            if "begun" in answer:
                listener.begun(answer["begun"])
            elif "ended" in answer:
                listener.ended(SceneOutcome.model_validate(answer["ended"]))
            else:
                for task_run in answer["task_runs"]:
                    note_task_run(UUID(task_run))
                if answer["error"]:
                    raise SceneLost(answer["error"])
                return

    def close(self) -> None:
        """Let it end by itself, and after a while by force."""
        with suppress(OSError):
            self._orders.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(END_SECONDS)
        self.kill()

    def kill(self) -> None:
        """End it at once."""
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        if self._answers >= 0:
            os.close(self._answers)
            self._answers = -1

    def _next(self, deadline: float | None, what: str, seconds: float) -> Any:
        with selectors.DefaultSelector() as ready:
            ready.register(self._answers, selectors.EVENT_READ)
            while b"\n" not in self._buffer:
                left = None if deadline is None else max(0.0, deadline - time.monotonic())
                if not ready.select(left):
                    took = f"took longer than {seconds:g} s {what}".rstrip()
                    raise SceneLost(f"{took}, and was ended")
                part = os.read(self._answers, 1 << 16)
                if not part:
                    raise self._died()
                self._buffer += part
        line, _, self._buffer = self._buffer.partition(b"\n")
        return json.loads(line)

    def _died(self) -> SceneLost:
        code = self._process.wait()
        if code >= 0:
            return SceneLost(f"its process ended with code {code}")
        name = signal.Signals(-code).name
        why = ": killed, perhaps for want of memory" if name == "SIGKILL" else ""
        return SceneLost(f"its process died of {name}{why}")


_idle: list[SceneProcess] = []
_busy: list[SceneProcess] = []
_lock = threading.Lock()


@contextmanager
def scene_process(store: str, threads: int) -> Iterator[SceneProcess]:
    """A process for one try: one that is idle, or a new one.

    It is kept for the next try, unless the block raises.
    """
    from prefect.settings import get_current_settings

    wanted = (store, threads, str(get_current_settings().api.url))
    with _lock:
        useless = [each for each in _idle if each.serves != wanted]
        for each in useless:
            _idle.remove(each)
        process = _idle.pop() if _idle else SceneProcess(store, threads)
        _busy.append(process)
    for each in useless:
        each.close()
    try:
        yield process
    except BaseException:
        with _lock:
            _busy.remove(process)
        process.kill()
        raise
    with _lock:
        _busy.remove(process)
        _idle.append(process)


def end_scene_processes() -> None:
    """End all of them, those that compute by force."""
    with _lock:
        busy, idle = list(_busy), list(_idle)
        _idle.clear()
    for process in busy:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    closing = [threading.Thread(target=process.close) for process in idle]
    for thread in closing:
        thread.start()
    for thread in closing:
        thread.join()
