"""Scenes handed out to a runner, a bounded number at a time, and tried again where they failed."""

from __future__ import annotations

import logging
import queue
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from prefect.futures import PrefectFuture

from flows.progress import Progress
from flows.run_config import RunConfig
from flows.runners import Placement
from flows.scene_outcome import Notes, SceneOutcome
from flows.scene_process import end_scene_processes
from flows.scene_task import OUTCOMES, lost_outcomes, scene_task, try_scene
from flows.scene_try import SceneTry, new_scene_run
from flows.suite import SuiteConfig

log = logging.getLogger(__name__)


@dataclass(eq=False)
class _Scene:
    """Where one scene stands."""

    dataset: str
    scene: str
    tries: int = 0
    """Tries of the scene, whichever lines they were for."""
    attempts: dict[str, int] = field(default_factory=dict)
    """Line -> tries of it; all lines, in the suite's order."""
    outcomes: dict[str, SceneOutcome] = field(default_factory=dict)
    """Line -> its latest outcome."""
    due: float = 0.0
    """Not to be tried again before, seconds of the monotonic clock."""

    def pending(self, retries: int) -> list[str]:
        """Lines that are to be run, those that were tried least first."""
        open_lines = [
            line
            for line, tried in self.attempts.items()
            if tried <= retries and not (tried and self._is_settled(line))
        ]
        return sorted(open_lines, key=lambda line: self.attempts[line])

    def _is_settled(self, line: str) -> bool:
        outcome = self.outcomes[line]
        return not outcome.failed or outcome.bad_input

    def note(self, outcomes: Sequence[SceneOutcome]) -> None:
        for outcome in outcomes:
            line = outcome.result.method
            self.attempts[line] += outcome.result.attempts
            result = outcome.result.model_copy(update={"attempts": self.attempts[line]})
            self.outcomes[line] = outcome.model_copy(update={"result": result})


def run_scenes(
    suite: SuiteConfig,
    scenes: Sequence[tuple[str, str]],
    store: str,
    run_id: str,
    placement: Placement,
    progress: bool = False,
) -> list[SceneOutcome]:
    """All lines of a suite on all its scenes; to be called inside the benchmark flow.

    Args:
        suite: The suite.
        scenes: Data set and name of each scene.
        store: Where the artifact store is.
        run_id: Tags the scenes' flow runs.
        placement: How the scenes are handed to the task runner.
        progress: Show progress bars.

    Returns:
        The outcomes, in the order of the scenes and of the suite's lines, however they ended.
    """
    lines = [line.name for line in suite.lines()]
    states = [_Scene(*pair, attempts=dict.fromkeys(lines, 0)) for pair in scenes]
    with Progress(shown=progress and placement.parallel) as bars:
        done = iter(bars.track(states, "scenes"))
        next(done, None)
        fan = _Fan(suite, store, run_id, placement, progress and not placement.parallel)
        try:
            fan.run(states, lambda: next(done, None))
        except BaseException:  # Ctrl-C does not wait for scenes that are being computed
            end_scene_processes()
            raise
    return [state.outcomes[line] for state in states for line in lines]


class _Fan:
    """Hands scenes out and takes their outcomes in."""

    def __init__(
        self, suite: SuiteConfig, store: str, run_id: str, placement: Placement, progress: bool
    ) -> None:
        self._suite = suite.model_dump(mode="json")
        self._run: RunConfig = suite.run
        self._store, self._run_id, self._progress = store, run_id, progress
        self._placement = placement
        self._ended: queue.Queue[tuple[_Scene, SceneTry, PrefectFuture[Any]]] = queue.Queue()

    def run(self, states: Sequence[_Scene], settled: Callable[[], object]) -> None:
        ready, waiting = deque(states), list[_Scene]()
        flying = 0
        while ready or waiting or flying:
            now = time.monotonic()
            for state in [each for each in waiting if each.due <= now]:
                waiting.remove(state)
                ready.appendleft(state)
            while ready and flying < self._placement.in_flight:
                state = ready.popleft()
                order = self._order(state)
                if self._hand_out(state, order):
                    flying += 1
                else:
                    self._take_in(state, waiting, settled)
            if not flying:
                if not ready and waiting:
                    time.sleep(max(0.0, min(each.due for each in waiting) - time.monotonic()))
                continue
            soonest = min((each.due for each in waiting), default=None)
            rest = None if soonest is None else max(0.0, soonest - time.monotonic())
            try:
                state, order, future = self._ended.get(timeout=rest)
            except queue.Empty:
                continue
            flying -= 1
            state.note(_outcomes(order, future))
            self._take_in(state, waiting, settled)

    def _order(self, state: _Scene) -> SceneTry:
        state.tries += 1
        return SceneTry(
            suite=self._suite,
            dataset=state.dataset,
            scene=state.scene,
            lines=tuple(state.pending(self._run.retries)),
            store=self._store,
            flow_run=new_scene_run(state.dataset, state.scene, state.tries, self._run_id),
            number=state.tries,
            threads=self._placement.threads,
            scene_seconds=self._run.scene_seconds,
            progress=self._progress,
        )

    def _hand_out(self, state: _Scene, order: SceneTry) -> bool:
        """Whether the outcomes are still to come."""
        if not self._placement.parallel:
            state.note(try_scene(order, apart=False))
            return False
        name = f"{state.dataset}/{state.scene} · {order.number}"
        try:
            future = scene_task.submit(order.model_dump(mode="json"), self._placement.apart, name)
        except Exception as error:  # a cluster that is gone
            state.note(lost_outcomes(order, Notes(), error))
            return False
        future.add_done_callback(lambda ended: self._ended.put((state, order, ended)))
        return True

    def _take_in(self, state: _Scene, waiting: list[_Scene], settled: Callable[[], object]) -> None:
        if state.pending(self._run.retries):
            fresh = any(state.attempts[line] == 0 for line in state.pending(self._run.retries))
            state.due = time.monotonic() + (0 if fresh else self._run.retry_delay_seconds)
            waiting.append(state)
            log.warning(
                "%s/%s failed in try %d and is tried again", state.dataset, state.scene, state.tries
            )
        else:
            settled()


def _outcomes(order: SceneTry, future: PrefectFuture[Any]) -> tuple[SceneOutcome, ...]:
    try:
        return OUTCOMES.validate_json(future.result(raise_on_failure=False))
    except Exception as error:  # its worker is gone, or the task crashed
        return lost_outcomes(order, Notes(), error)
