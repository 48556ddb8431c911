"""A stage: a plain function with a name, a version and a slice of the configuration.

`run_stage` runs it once for each cache key. Inside a Prefect flow or task that is one Prefect
task run, whose state is ``Cached`` where nothing had to be computed; elsewhere the function is
called directly, through the same store and with the same result. Prefect is imported only where
it already is.

The cache key is made of the stage's name and version, the digests of its inputs and its own
slice of the configuration (`tasks.records.stage_key`). Arrays never pass between stages: they
lie in the store, and stages take and return handles.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

from pydantic import BaseModel

from gvr_core.errors import ConfigError, StoreError
from tasks.findings import Notes
from tasks.record_store import StageOutput
from tasks.records import Artifact, StageRecord, check_stage_name, stage_key
from tasks.store import Store

StageState = Literal["Completed", "Cached"]
"""Prefect's names: ``Completed`` was computed by this very call, ``Cached`` was not."""


@dataclass(frozen=True)
class StageRun:
    """How one call of `run_stage` ended."""

    record: StageRecord
    state: StageState
    label: str = ""
    """What it was run for, e.g. ``"gallery/seed0"``."""
    notes: Notes = field(default_factory=Notes)
    """What was found damaged on the way, and what the shared store did."""

    @property
    def cached(self) -> bool:
        """Whether nothing had to be computed."""
        return self.state == "Cached"

    @property
    def artifacts(self) -> dict[str, Artifact]:
        """The artifacts by name."""
        return self.record.artifacts

    @property
    def digest(self) -> str:
        """sha256 over all artifacts: this result as an input of another stage."""
        return self.record.digest

    def __getitem__(self, name: str) -> Artifact:
        return self.record.artifacts[name]


StageInput = str | Artifact | StageRecord | StageRun
"""An input: a sha256 of something outside the store, or a handle to what is in it."""


@dataclass(frozen=True)
class Stage:
    """The declaration of a stage.

    Args:
        name: A lower-case word: the Prefect task's name and the folder of the records.
        version: At least 1; raise it whenever the results may differ from those before.
        function: ``function(store, inputs, config, **runtime)``, with the inputs as given to
            `run_stage`, the slice of the configuration as JSON values, and what `run_stage` was
            given as ``runtime``. Returns its artifacts by name, or a `StageOutput`. It should be
            importable by name, so that it can be sent to another process.
        config: The parts of the configuration that the results depend on, as dotted keys, e.g.
            ``("views.count", "depth")``. The function sees these parts and no others.

    Raises:
        StoreError: A name or version that cannot be used.
    """

    name: str
    version: int
    function: Callable[..., StageOutput | Mapping[str, Artifact]]
    config: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_stage_name(self.name)
        if type(self.version) is not int or self.version < 1:
            raise StoreError(f"stage {self.name}: version {self.version!r} (accepted: 1, 2, ...)")

    def slice(self, config: Mapping[str, Any] | BaseModel) -> dict[str, Any]:
        """The stage's own part of a configuration, as nested dicts of JSON values.

        Raises:
            ConfigError: The configuration lacks a key that the stage declares.
        """
        values = config.model_dump(mode="json") if isinstance(config, BaseModel) else config
        chosen: dict[str, Any] = {}
        for dotted in self.config:
            here: Any = values
            target = chosen
            parts = dotted.split(".")
            for index, part in enumerate(parts):
                if not isinstance(here, Mapping) or part not in here:
                    raise ConfigError(
                        f"stage {self.name} needs {dotted!r}, and the configuration has no"
                        f" {'.'.join(parts[: index + 1])!r}",
                        accepted=_keys(here),
                    )
                here = here[part]
                if index < len(parts) - 1:
                    target = target.setdefault(part, {})
            target[parts[-1]] = here
        return chosen

    def key(self, inputs: Mapping[str, StageInput], config: Mapping[str, Any] | BaseModel) -> str:
        """The cache key for these inputs and this (whole) configuration.

        Raises:
            ConfigError: The configuration lacks a key that the stage declares.
            StoreError: An input that is no digest, or a value that JSON does not have.
        """
        return stage_key(self.name, self.version, _digests(inputs), self.slice(config))


def run_stage(
    stage: Stage,
    store: Store,
    inputs: Mapping[str, StageInput],
    config: Mapping[str, Any] | BaseModel,
    *,
    label: str = "",
    runtime: Mapping[str, Any] | None = None,
    refresh: bool = False,
) -> StageRun:
    """Run a stage, or find its result in the store.

    Args:
        stage: The stage.
        store: Where results lie.
        inputs: Its inputs by name; their digests enter the cache key.
        config: The whole configuration; only the stage's slice enters the key and the function.
        label: What it is run for, e.g. ``"gallery/seed0"``; part of the Prefect task run's name.
        runtime: Keyword arguments for the function that do not change its results, and so are
            not in the key: a device, a number of workers, the path of a file whose digest is
            among the inputs.
        refresh: Compute even where there is a sound result.

    Returns:
        The record, and whether it was computed by this call.

    Raises:
        ConfigError: The configuration lacks a key that the stage declares.
        StoreError: What the stage returned cannot be stored, or an input cannot be a key.
        Exception: Whatever the stage's function raises.
    """
    key = stage.key(inputs, config)
    function = partial(stage.function, store, dict(inputs), stage.slice(config), **(runtime or {}))
    notes = Notes()
    named = (store, stage.name, stage.version, key, function)
    if _inside_prefect():
        from tasks.prefect_task import run_as_task

        record, state = run_as_task(*named, label=label, refresh=refresh, notes=notes)
        return StageRun(record, state, label, notes)
    record, computed = Store.compute_once(*named, refresh=refresh, notes=notes)
    return StageRun(record, "Completed" if computed else "Cached", label, notes)


def _digests(inputs: Mapping[str, StageInput]) -> dict[str, str]:
    return {
        name: value if isinstance(value, str) else value.digest for name, value in inputs.items()
    }


def _keys(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(sorted(map(str, value))) or "nothing"
    return "a table of settings"


def _inside_prefect() -> bool:
    """Whether a flow or task is running here; False without importing Prefect."""
    context = sys.modules.get("prefect.context")
    if context is None:
        return False
    return context.FlowRunContext.get() is not None or context.TaskRunContext.get() is not None
