"""The result record: what a benchmark run found. Everything people look at is made from it.

A result is a folder that is written once, under a temporary name, and never overwritten::

    <run id>/
        result.json       a Result: configuration, environment, one SceneResult per (scene, method)
        rows.jsonl        one Row a line: every (scene, method, query, view, protocol)
        rows.parquet      the same rows as a table
        pictures/         the target dyed red in a test view, one per query
        SHA256SUMS        sha256 of each file above

The order and meaning of the fields do not change without a new ``schema_version``; a field that
is added stands last, and has a default that is true of older results.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

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
