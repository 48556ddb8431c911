"""What the artifact store writes down: handles to objects, and one record for each stage result.

Everything here is plain JSON. A record read from disk is treated as hostile: it is parsed,
checked against the model, and never evaluated or unpickled.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError

from gvr_core.errors import StoreError

RECORD_SCHEMA: Literal[1] = 1
"""Layout of `StageRecord`; a record with another number is not read."""

DIGEST = re.compile(r"[0-9a-f]{64}")
"""A sha256 in lower-case hexadecimal digits."""

STAGE_NAME = re.compile(r"[a-z][a-z0-9_]{0,47}")
"""Names of stages: they become folder names and Prefect task names."""


class Artifact(BaseModel):
    """A handle to one immutable object of the store; what tasks pass to each other.

    `meta` describes the object for people and reports. It does not enter cache keys (those are
    made of `digest`), so whatever a later stage computes with belongs in the content.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: str = Field(min_length=1, max_length=64)
    """What it is, e.g. ``"depth_book"`` or ``"render"``."""
    digest: str = Field(pattern=r"^[0-9a-f]{64}$")
    """sha256 of the content."""
    path: str
    """Relative to the store's root, with forward slashes."""
    bytes: int = Field(ge=0)
    meta: dict[str, JsonValue] = Field(default_factory=dict)


class StageRecord(BaseModel):
    """What one stage computed for one cache key, and what that cost."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    schema_version: Literal[1] = Field(default=RECORD_SCHEMA, alias="schema")
    stage: str = Field(pattern=r"^[a-z][a-z0-9_]{0,47}$")
    version: int = Field(ge=1)
    key: str = Field(pattern=r"^[0-9a-f]{64}$")
    artifacts: dict[str, Artifact]
    seconds: float = Field(ge=0)
    """Wall-clock time of the computation, without waiting for locks."""
    cpu_seconds: float = Field(ge=0)
    """User and system time of this process and its finished children meanwhile."""
    peak_bytes: int = Field(ge=0)
    """Highest resident memory of the process; see `peak_of`."""
    peak_of: Literal["stage", "process"]
    """``stage``: the peak was reset at the start; ``process``: since the process began."""
    created: str
    """UTC, ISO 8601."""
    detail: dict[str, JsonValue] = Field(default_factory=dict)
    """Counts and the like that the stage reports about itself."""

    @property
    def digest(self) -> str:
        """sha256 over the names and contents of all artifacts: this result as an input."""
        named = {name: artifact.digest for name, artifact in self.artifacts.items()}
        return hashlib.sha256(canonical_json(named)).hexdigest()

    @property
    def total_bytes(self) -> int:
        """Size of all artifacts together."""
        return sum(artifact.bytes for artifact in self.artifacts.values())

    def to_json(self) -> dict[str, Any]:
        """This record as plain JSON values, with the sha256 of their canonical text as ``sum``."""
        values = self.model_dump(mode="json", by_alias=True)
        return {**values, "sum": hashlib.sha256(canonical_json(values)).hexdigest()}

    @classmethod
    def from_json(cls, text: str | bytes) -> StageRecord:
        """Read a record.

        Raises:
            StoreError: The text is not JSON, not a record of this schema, or it was changed
                after it was written. Records of before there were sums are taken without.
        """
        try:
            values = json.loads(text)
            found = values.pop("sum", None) if isinstance(values, dict) else None
            rest = canonical_json(values)
            if found is not None and found != hashlib.sha256(rest).hexdigest():
                raise StoreError("a stage record was changed after it was written")
            return cls.model_validate_json(rest)
        except (ValidationError, ValueError, RecursionError) as error:
            raise StoreError(f"not a stage record of schema {RECORD_SCHEMA}: {error}") from error


def canonical_json(value: object, *, name: str = "value") -> bytes:
    """The one JSON text of a value: sorted keys, no spaces, ASCII, no NaN.

    Args:
        value: Nested dicts with string keys, lists, strings, finite numbers, booleans, None.
        name: What to call it in an error.

    Raises:
        StoreError: Anything else is in there; the message gives the place.
    """
    _require_json(value, name)
    return json.dumps(
        value, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False
    ).encode("ascii")


def stage_key(
    stage: str, version: int, inputs: Mapping[str, str], config: Mapping[str, Any]
) -> str:
    """The cache key of a stage.

    Args:
        stage: The stage's name.
        version: Its version; raised whenever its results may change.
        inputs: Digest (sha256, hexadecimal) of each input by name.
        config: The stage's own slice of the configuration, as JSON values.

    Returns:
        sha256 of the canonical JSON of the four.

    Raises:
        StoreError: A bad name, an input that is no digest, or a value JSON does not have.
    """
    check_stage_name(stage)
    for name, digest in inputs.items():
        if not isinstance(digest, str) or not DIGEST.fullmatch(digest):
            raise StoreError(
                f"stage {stage}: input {name!r} is {digest!r} (accepted: a sha256 in hexadecimal)"
            )
    parts = {
        "stage": stage,
        "version": version,
        "inputs": dict(inputs),
        "config": dict(config),
    }
    return hashlib.sha256(canonical_json(parts, name=f"stage {stage}")).hexdigest()


def check_stage_name(stage: str) -> str:
    """Return the name, or refuse one that could not be a folder name everywhere.

    Raises:
        StoreError: It is not a lower-case word.
    """
    if not isinstance(stage, str) or not STAGE_NAME.fullmatch(stage):
        raise StoreError(
            f"stage name {stage!r} (accepted: a lower-case letter, then up to 47 of a-z, 0-9, _)"
        )
    return stage


def check_key(key: str) -> str:
    """Return the key, or refuse what is not a sha256.

    Raises:
        StoreError: It is not 64 lower-case hexadecimal digits.
    """
    if not isinstance(key, str) or not DIGEST.fullmatch(key):
        raise StoreError(f"stage key {key!r} (accepted: a sha256 in hexadecimal)")
    return key


def _require_json(value: object, place: str) -> None:
    """Refuse what ``json.dumps`` would turn into something else without saying so."""
    if value is None or type(value) in (bool, int, str):
        return
    if type(value) is float:
        if not math.isfinite(value):
            raise StoreError(f"{place} is {value} (accepted: finite numbers)")
    elif type(value) is list:
        for index, item in enumerate(value):
            _require_json(item, f"{place}[{index}]")
    elif type(value) is dict:
        for key, item in value.items():
            # json.dumps would write 1 and "1" as the same key.
            if type(key) is not str:
                raise StoreError(f"{place} has the key {key!r} (accepted: strings)")
            _require_json(item, f"{place}.{key}")
    else:
        raise StoreError(
            f"{place} is of type {type(value).__name__}"
            " (accepted: dict, list, str, int, float, bool, None)"
        )
