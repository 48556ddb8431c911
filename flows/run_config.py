"""How a suite is run: where its scenes are computed, how many at once, how often they are tried.

Nothing in here changes a result, and so nothing of it is in a cache key.
"""

from __future__ import annotations

from importlib import util
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from gvr_core.errors import ConfigError
from gvr_core.threads import available_threads

RunnerName = Literal["serial", "threads", "processes", "dask"]


class RunConfig(BaseModel):
    """The ``[run]`` table of a suite."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    runner: RunnerName = "serial"
    """``serial`` computes one scene after the other in this process, ``threads`` several in it,
    ``processes`` several in processes of their own, ``dask`` on a Dask cluster."""
    workers: int | None = Field(default=None, ge=1)
    """Threads, processes or Dask workers; where left out as many as there are processors."""
    scenes_in_flight: int | None = Field(default=None, ge=1)
    """At most so many scenes are handed out at once; where left out one for each worker."""
    dask_scheduler: str | None = Field(default=None, min_length=1)
    """Address of a running Dask scheduler, such as ``tcp://10.0.0.5:8786``; where left out the
    run starts a cluster on 127.0.0.1, and stops it."""
    retries: int = Field(default=1, ge=0)
    """How often what failed on a scene is tried again. What a user gave is not: it stays wrong."""
    retry_delay_seconds: float = Field(default=2.0, ge=0)
    """Rest before a scene is tried again; other scenes go on meanwhile."""
    scene_seconds: float | None = Field(default=None, gt=0)
    """Time limit of one try of one scene, after which its process is ended."""

    @model_validator(mode="after")
    def _fits_together(self) -> RunConfig:
        if self.scene_seconds is not None and self.runner in ("serial", "threads"):
            raise ConfigError(
                f"run.scene_seconds with the runner {self.runner!r}, which cannot end a scene",
                accepted="scene_seconds with processes or dask",
            )
        if self.dask_scheduler is not None and self.runner != "dask":
            raise ConfigError(
                f"run.dask_scheduler with the runner {self.runner!r}",
                accepted="dask_scheduler with dask",
            )
        if self.dask_scheduler is not None and self.workers is not None:
            raise ConfigError(
                "both run.dask_scheduler and run.workers",
                accepted="either: a running cluster has its own workers",
            )
        if self.runner == "serial" and (self.workers or 1) > 1:
            raise ConfigError(
                f"run.workers = {self.workers} with the runner 'serial'",
                accepted="workers with threads, processes or dask",
            )
        return self

    def workers_for(self, scenes: int) -> int:
        """Number of workers for so many scenes."""
        if self.runner == "serial":
            return 1
        return max(1, min(self.workers or available_threads(), scenes))


def override_run(run: RunConfig, runner: str | None, workers: int | None) -> RunConfig:
    """The settings with choices made on the command line.

    Raises:
        ConfigError: for a choice that cannot be.
    """
    changes: dict[str, Any] = {}
    if runner is not None:
        changes["runner"] = runner
        if runner in ("serial", "threads"):
            changes |= {"scene_seconds": None}
        if runner == "serial":
            changes |= {"workers": None}
        if runner != "dask":
            changes |= {"dask_scheduler": None}
    if workers is not None:
        changes |= {"workers": workers, "dask_scheduler": None}
    try:
        return RunConfig.model_validate(run.model_dump() | changes)
    except ValidationError as error:
        problem = error.errors()[0]
        place = f"--{problem['loc'][0]}"
        raise ConfigError(f"{problem['msg']}, not {problem['input']!r}", place=place) from error


def check_runner(run: RunConfig) -> None:
    """Refuse a runner whose packages are not installed.

    Raises:
        ConfigError: naming the command that installs them.
    """
    missing = [name for name in ("distributed", "prefect_dask") if not util.find_spec(name)]
    if run.runner == "dask" and missing:
        raise ConfigError(
            f"the runner 'dask' needs {' and '.join(missing)}, not installed here",
            accepted="pip install 'gvr-bench[dask]' -c constraints.txt, or another runner",
        )
