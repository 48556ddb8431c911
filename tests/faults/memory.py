"""A stage that runs out of memory: its line fails, and the others go on."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from faults import children
from faults.checks import losses_after
from faults.kills import again
from faults.lines import Line
from faults.work import Work, comparable, emptied
from gvr_core.methods import MethodConfig
from reports.result_io import list_results
from tasks.record_store import RecordStore


def two_methods(work: Work) -> Work:
    """The same work with a second method."""
    methods = (*work.suite.methods, MethodConfig(method="gvr-paper"))
    return replace(work, suite=work.suite.model_copy(update={"methods": methods}))


def run_out_of_memory(work: Work, folder: Path, stages: Sequence[str], line: Line) -> None:
    """Let each of some stages of the first method run out of memory once.

    Args:
        work: The work, with one method.
        folder: For stores and results.
        stages: Which stages.
        line: Where tries are counted.
    """
    both = two_methods(work)
    whole = emptied(folder / "two-methods")
    reference = comparable(again(both, whole / "store", whole / "results"))
    for stage in stages:
        place = emptied(folder / "memory")
        store, results = place / "store", place / "results"

        def greedy(store: Path = store, results: Path = results, stage: str = stage) -> None:
            _ask_for_too_much(stage)
            both.run(store, results)

        ended = children.run(greedy)
        losses = []
        if ended.code != 1 or "MemoryError" not in ended.last_line:
            losses.append(f"exit code {ended.code}: {ended.last_line}")
        (result,) = list_results(results)
        scenes = json.loads((result / "result.json").read_text())["scenes"]
        statuses = [scene["status"] for scene in scenes]
        if statuses != ["failed", "completed"]:
            losses.append(f"the methods ended as {statuses}")
        losses += losses_after(store, results, reference, partial(again, both, store, results))
        line.add(losses, stage)


def _ask_for_too_much(stage: str) -> None:
    """The stage's first computation asks for more memory than addresses."""
    real = RecordStore.compute_once
    asked: list[str] = []

    def compute_once(
        store: RecordStore, name: str, version: int, key: str, function: Any, **named: Any
    ) -> Any:
        def greedy() -> Any:
            if name == stage and not asked:
                asked.append(name)
                np.ones(1 << 60, np.uint8)
            return function()

        return real(store, name, version, key, greedy, **named)

    RecordStore.compute_once = compute_once  # type: ignore[method-assign]
