"""A process that computes scenes: ``python -m flows.scene_worker ANSWERS STORE``.

Reads tries as JSON lines from standard input, and writes JSON lines to the file descriptor
ANSWERS: ``{"ready": true}`` once; of each try ``{"begun": line}``, ``{"ended": outcome}``, and last
``{"error": ...}``. It ends when standard input does, at once where a scene is being computed:
whoever asked is gone.
"""

from __future__ import annotations

import json
import os
import queue
import sys
import threading
from typing import Any

from flows.scene_outcome import SceneOutcome
from tasks.prefect_drain import drain, take_task_runs
from tasks.prefect_runtime import prefect_runtime
from tasks.store import Store


class _Answers:
    """Writes what it is told, a JSON line each."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def begun(self, line: str) -> None:
        self.write({"begun": line})

    def ended(self, outcome: SceneOutcome) -> None:
        self.write({"ended": outcome.model_dump(mode="json")})

    def write(self, answer: dict[str, Any]) -> None:
        data = json.dumps(answer).encode() + b"\n"
        while data:
            data = data[os.write(self._descriptor, data) :]


def main(descriptor: int, store: str) -> None:
    """Make tries until standard input ends."""
    orders: queue.Queue[bytes | None] = queue.Queue()
    idle = threading.Event()
    idle.set()

    def read() -> None:
        for line in sys.stdin.buffer:
            orders.put(line)
        if not idle.is_set():
            os._exit(1)
        orders.put(None)

    answers = _Answers(descriptor)
    with prefect_runtime(Store(store)):
        from flows.scene_try import SceneTry, run_here

        threading.Thread(target=read, daemon=True).start()
        answers.write({"ready": True})
        while (line := orders.get()) is not None:
            idle.clear()
            error = ""
            try:
                run_here(SceneTry.model_validate_json(line), answers)
            except Exception as raised:
                error = f"{type(raised).__name__}: {raised}"
            idle.set()
            runs = [str(task_run) for task_run in take_task_runs()]
            answers.write({"error": error, "task_runs": runs})
        drain()


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
