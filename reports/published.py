"""Published numbers as records: read from ``published.toml``, checked, and never measured here.

The file says where each number comes from and under which protocol it was made, as far as that is
known. A number whose protocol is not known has none: it may stand beside measured ones as context,
and says nothing about a method alone.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from gvr_core.errors import ConfigError
from gvr_core.protocols import PROTOCOLS

ROUNDING = 0.06
"""An overall further than this from the mean of its scenes is more than rounded to a tenth."""

DatasetName = Literal["lerf_ovs", "lerf_mask", "ovs3d"]
Values = dict[str, float]
"""Metric, named as in the protocol beside which it stands -> per cent."""


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class PublishedRow(_Record):
    """What one source says of one method on one data set."""

    method: str = Field(min_length=1)
    dataset: DatasetName
    family: str
    """The block of numbers that it belongs to; those of two families share no table."""
    reported_protocol: str = Field(min_length=1)
    """How the numbers were made, as far as that is known."""
    protocol: str | None = None
    """Id of the protocol, only where the numbers were made by the evaluator that it follows."""
    relative_to: str | None = None
    """The method that the values are differences to; None where they are values themselves."""
    scenes: dict[str, Values] = Field(default_factory=dict)
    """Scene, named as in the data set -> values; empty where only the overall is known."""
    overall: Values = Field(default_factory=dict)
    """The mean over scenes, as printed."""
    recomputed: Values = Field(default_factory=dict)
    """The mean over scenes as the scenes have it, where it is known to differ from the printed
    one and the scenes themselves are not known here."""
    training_free: bool | None = None
    """Whether nothing is trained for a scene; None where it was not said."""
    prepare_seconds: float | None = Field(default=None, gt=0)
    """To prepare a scene; ``note`` says where it does not cover everything."""
    query_seconds: float | None = Field(default=None, gt=0)
    source: str = Field(min_length=1)
    first_hand: bool = False
    """Whether it was read in the publication of the method itself; else someone repeated it."""
    note: str = ""

    @model_validator(mode="after")
    def _adds_up(self) -> PublishedRow:
        if not (self.scenes or self.overall):
            raise ValueError("has no numbers")
        for metric, value in self.overall.items():
            mean = self.true_overall(metric)
            if mean is not None and f"{mean:.1f}" not in self.note:
                raise ValueError(
                    f"overall {metric} {value} is not the mean of its scenes, and the note does "
                    f"not say that this is {mean:.1f}"
                )
        return self

    def mean_of_scenes(self, metric: str) -> float | None:
        """The unweighted mean over the scenes that have the metric; None where none has it."""
        found = [values[metric] for values in self.scenes.values() if metric in values]
        return math.fsum(found) / len(found) if found else None

    def true_overall(self, metric: str) -> float | None:
        """The mean over scenes, where the printed overall is another number; else None."""
        if metric not in self.overall:
            return None
        mean = self.recomputed.get(metric, self.mean_of_scenes(metric))
        differs = mean is not None and abs(mean - self.overall[metric]) > ROUNDING
        return mean if differs else None


class Family(_Record):
    """A block of published numbers that were put into one table by their sources."""

    id: str
    about: str = Field(min_length=1)
    """What its numbers are, in the titles of tables."""
    dataset: DatasetName
    beside: tuple[str, ...]
    """Protocols, without version, next to whose measured numbers it may stand."""
    metrics: tuple[str, ...] = Field(min_length=1)
    """In table order."""
    scenes: tuple[str, ...] = Field(min_length=1)
    """In table order."""
    reported_protocol: str = Field(min_length=1)
    """How its numbers were made, except where a row says otherwise."""
    pairs: dict[str, int] = Field(default_factory=dict)
    """Scene -> its labelled (prompt, view) pairs, where they are known."""
    rows: tuple[PublishedRow, ...]

    @model_validator(mode="after")
    def _fits(self) -> Family:
        names = [row.method for row in self.rows]
        if len(set(names)) < len(names):
            raise ValueError("a method is there twice")
        strange = {scene for row in self.rows for scene in row.scenes} - set(self.scenes)
        every = [values for row in self.rows for values in (*row.scenes.values(), row.overall)]
        strange |= {metric for values in every for metric in values} - set(self.metrics)
        strange |= set(self.pairs) - set(self.scenes)
        strange |= {row.protocol for row in self.rows if row.protocol} - set(PROTOCOLS)
        strange |= {row.relative_to for row in self.rows if row.relative_to} - set(names)
        if strange:
            raise ValueError(f"speaks of {', '.join(sorted(strange))}, which it does not have")
        return self

    def stands_beside(self, protocol: str) -> bool:
        """Whether the family may stand next to numbers of a protocol id, of any version."""
        return protocol.partition("/")[0] in self.beside


def read_published(path: Path) -> tuple[Family, ...]:
    """Read and check a file of published numbers.

    Args:
        path: TOML: ``[[families]]`` with ``[[families.rows]]``; what a row leaves out of data set
            and ``reported_protocol``, its family says.

    Raises:
        ConfigError: for a file that cannot be read, a field that is not known or has another
            type, a scene or metric that its family does not have, or an overall that is not the
            mean of its scenes where the note does not give that mean.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"cannot be read: {error}", path=path, accepted="a TOML file") from error
    families = content.get("families")
    if not isinstance(families, list):
        raise ConfigError("no families", path=path, accepted="[[families]] with [[families.rows]]")
    return tuple(_family(path, number, each) for number, each in enumerate(families))


def _family(path: Path, number: int, content: Mapping[str, Any]) -> Family:
    own = dict(content)
    shared = {name: own.get(name) for name in ("dataset", "reported_protocol")}
    shared["family"] = own.get("id")
    rows = own.get("rows")
    if isinstance(rows, list):
        own["rows"] = [shared | row if isinstance(row, dict) else row for row in rows]
    try:
        return Family.model_validate(own)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in ("families", number, *first["loc"]))
        message = first["msg"].removeprefix("Value error, ")
        raise ConfigError(message, path=path, place=place) from error


@lru_cache(maxsize=1)
def families() -> tuple[Family, ...]:
    """All families of published numbers that come with the project."""
    return read_published(Path(str(resources.files("reports") / "published.toml")))


def families_of(dataset: str, protocol: str | None = None) -> tuple[Family, ...]:
    """The families of a data set.

    Args:
        dataset: Name of the data set; one that nothing was published on has none.
        protocol: Id; only the families that may stand next to its numbers.
    """
    return tuple(
        family
        for family in families()
        if family.dataset == dataset and (protocol is None or family.stands_beside(protocol))
    )


def published(dataset: str, protocol: str | None = None) -> tuple[PublishedRow, ...]:
    """The published rows of a data set, in the file's order.

    Args:
        dataset: Name of the data set.
        protocol: Id; only rows that may stand next to its numbers. That is not to say that they
            were made under it: :attr:`PublishedRow.protocol` does, where it is known.
    """
    return tuple(row for family in families_of(dataset, protocol) for row in family.rows)
