"""``gvr run --dry-run``: which stages are in the store, and which would be computed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from flows.scene_setup import line_job, load_scene
from flows.suite import SuiteConfig, resolve_scenes
from tasks.stages import stages_in_store
from tasks.store import Store

State = Literal["cached", "to compute"]


@dataclass(frozen=True)
class PlannedLine:
    """One line on one scene, and what would become of each of its stages."""

    dataset: str
    scene: str
    line: str
    stages: dict[str, State]
    """Stage name -> state, in the order of running."""

    @property
    def to_compute(self) -> list[str]:
        """Names of the stages that are not in the store."""
        return [name for name, state in self.stages.items() if state == "to compute"]


def plan(suite: SuiteConfig, store: Store) -> list[PlannedLine]:
    """What a run of a suite would compute.

    Scenes are read (and made, where a data set makes its own); no stage runs.

    Args:
        suite: The suite.
        store: Where results of stages lie.

    Raises:
        ConfigError: for a scene, method or model that is not known.
        InputError: for a scene that cannot be read.
        ModelError: for weights that are missing or wrong.
    """
    choices = {choice.name: choice for choice in suite.datasets}
    planned = []
    for dataset, scene in resolve_scenes(suite.datasets):
        data = load_scene(choices[dataset], scene, suite.exclude_eval_views)
        for line in suite.lines():
            job = line_job(data, suite, line, store)
            stages: dict[str, State] = {
                name: "cached" if found else "to compute"
                for name, found in stages_in_store(job).items()
            }
            planned.append(PlannedLine(dataset, scene, line.name, stages))
    return planned
