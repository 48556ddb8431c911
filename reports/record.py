"""The result record: what a benchmark run found. Everything people look at is made from it.

A result is a folder that is written once, under a temporary name, and never overwritten::

    <run id>/
        result.json       a Result: configuration, environment, one SceneResult per (scene, method)
        rows.jsonl        one Row a line: every (scene, method, query, view, protocol)
        rows.parquet      the same rows as a table
        pictures/         the target dyed red in a test view, one per query
        evidence/         the steps behind the answers, one file per (scene, method)
        SHA256SUMS        sha256 of each file above

The order and meaning of the fields do not change without a new ``schema_version``; a field that
is added stands last, and has a default that is true of older results.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

SCHEMA_VERSION = 1
"""Version of the records in this file."""


Seconds = Annotated[float, Field(ge=0, le=1e12)]
"""A duration; 1e12 is thirty thousand years."""

Count = Annotated[int, Field(ge=0, lt=2**63)]
"""A number of things; a larger one no table or database could hold."""


class _Record(BaseModel):
    # A NaN is an error where the record is made, while its cause is still known; in a file it
    # would silently become a null.
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Row(_Record):
    """The metrics of one query under one protocol, in one view or over the Gaussians."""

    dataset: str
    scene: str
    method: str
    query: str
    """The query's id."""
    text: str
    """The words given to the method."""
    target: str | None
    """The object meant."""
    absent: bool
    """True where the object is known not to be in the scene."""
    protocol: str
    """Name and version of the protocol, e.g. ``flags_3d/1``. Rows of two protocols never mix."""
    view: str | None
    """The test view, or None where the protocol scores the Gaussians themselves."""
    metrics: dict[str, float]
    """Metric name -> value. What is undefined is left out, never NaN or infinity."""


class Damage(_Record):
    """A file of the artifact store that was not what it should be when it was looked up."""

    what: Literal["artifact", "record"]
    where: Literal["local", "shared"]
    """In the store's folder, or in the shared one behind a URL."""
    path: str
    """Relative to the store."""
    finding: str
    """``is missing``, ``has 12 bytes instead of 40``, ``has another content than ...``."""


class StageTiming(_Record):
    """What one stage of one scene cost when it was computed."""

    stage: str
    seconds: Seconds
    """Wall time of the computation; of the original one where the stage was cached."""
    cpu_seconds: Seconds
    peak_bytes: Count
    """Peak resident memory of the process during the stage."""
    state: Literal["computed", "cached"]
    """Whether this run computed it."""
    key: str
    """The stage's cache key."""
    peak_of: Literal["stage", "shared", "process"] | None = None
    """What the peak is of: ``stage``, of this stage alone; ``shared``, also of other scenes' stages
    that ran at the same time in threads of the process; ``process``, since the process began. None
    in results from before it was noted."""
    damage: tuple[Damage, ...] = ()
    """What was found damaged when it was looked up; it was computed again then, or fetched."""
    fetched: bool = False
    """Whether it was cached in a shared store alone, and came from there."""
    unshared: str = ""
    """Why a shared store could not be asked, or did not get it; empty where nothing failed."""

    @property
    def shown_state(self) -> str:
        """The state, and what lies behind it."""
        if self.damage:
            return "fetched again (damaged)" if self.state == "cached" else "recomputed (damaged)"
        return "fetched" if self.fetched else self.state


class QueryOutcome(_Record):
    """What a method answered to one query."""

    query: str
    found: bool
    location: tuple[float, float, float] | None
    """L_3D, world frame."""
    n_flagged: Count
    """Number of target Gaussians."""
    confidence: float
    seconds: dict[str, Seconds]
    """Stage -> wall seconds of this query alone."""
    picture: str | None = None
    """Path of its picture, relative to the result's folder."""
    text: str = ""
    """The words given to the method; empty in results from before they were kept here."""


class SceneResult(_Record):
    """One method, with one set of models, on one scene."""

    dataset: str
    scene: str
    method: str
    """Unique in the run: label and model set."""
    status: Literal["completed", "failed"]
    error: str | None = None
    n_gaussians: Count = 0
    n_views: Count = 0
    n_patches: Count = 0
    picture_size: tuple[Count, Count] = (0, 0)
    """Width and height of the knowledge views, pixels."""
    models: dict[str, str] = Field(default_factory=dict)
    """Role -> model name with version and settings."""
    digests: dict[str, str] = Field(default_factory=dict)
    """Part of the data set -> sha256."""
    prepare_seconds: Seconds = 0.0
    """Preparation time of the paper's second table: the stages before any query."""
    query_seconds: Seconds = 0.0
    """Query time of the paper's second table: mean over queries of localising and segmenting."""
    stages: tuple[StageTiming, ...] = ()
    queries: tuple[QueryOutcome, ...] = ()
    label: str = ""
    """The method's name without the model set; empty where ``method`` says it all."""
    model_set: str = ""
    """Which of several sets of models it ran with; empty where there is one without a label."""
    reference: str | None = None
    """``method`` of the results that these are compared with, on the same scenes."""
    original: bool = False
    """Whether the scene is taken for the data that published numbers are on."""
    attempts: int = Field(default=1, ge=0)
    """How often it was tried: more than once where a failure was tried again."""
    evidence: str | None = None
    """Path of the evidence for its answers, relative to the result's folder."""

    @property
    def peak_bytes(self) -> int:
        """Peak resident memory over all stages; 0 where none is known."""
        return max((stage.peak_bytes for stage in self.stages), default=0)

    @property
    def peak_is_own(self) -> bool:
        """Whether no other work of the process is in that peak."""
        return all(stage.peak_of == "stage" for stage in self.stages)

    @property
    def shown_label(self) -> str:
        """The label, or the method where it has none."""
        return self.label or self.method


class Environment(_Record):
    """Where and with what a result was made."""

    python: str
    platform: str
    processor: str
    cpu_count: Count
    gpu: str | None
    git_revision: str | None
    git_dirty: bool | None
    packages: dict[str, str]


class SystemLoad(_Record):
    """What the machine was doing while the benchmark ran."""

    seconds: tuple[Seconds, ...]
    """When each sample was taken, after the start."""
    values: dict[str, tuple[float, ...]]
    """Name as in MLflow's system metrics, with its unit -> one value for each sample."""

    @model_validator(mode="after")
    def _as_many_values_as_samples(self) -> SystemLoad:
        for name, values in self.values.items():
            if len(values) != len(self.seconds):
                raise ValueError(f"{name} has {len(values)} values at {len(self.seconds)} times")
        return self


class Result(_Record):
    """A benchmark run."""

    schema_version: int = SCHEMA_VERSION
    run_id: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,127}$")
    """Unique; safe as a folder's name and in a search of MLflow."""
    suite: str
    created: str
    """UTC, ISO 8601."""
    wall_seconds: Seconds
    config: dict[str, Any]
    """The resolved configuration, complete: every default is written out."""
    environment: Environment
    scenes: tuple[SceneResult, ...]
    started_by: Literal["hand", "schedule"] | None = None
    """Who started it; None in results from before it was noted, and of `gvr score`."""
    system: SystemLoad | None = None
    """None where it was not sampled, or the run was over before the first sample."""
