"""The content of one MLflow run, and the names and lengths that MLflow takes.

A metric is called ``<protocol>/<metric>``, e.g. ``lerf_mask.gg/1/iou``, and its value is the
protocol's own mean. Our headline numbers have short names besides (`reports.headline`).
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gvr_core.protocols import PROTOCOLS
from reports.headline import HEADLINE
from reports.record import Environment, Result

MAX_KEY = 250
MAX_VALUE = 5000
"""MLflow takes parameters of 6000 characters, and tags of 8000."""
_CUT = " ... (cut: the whole is in result.json)"


@dataclass(frozen=True)
class Point:
    """One value of a metric."""

    key: str
    value: float
    step: int = 0
    seconds: float = 0.0
    """When, after the start of the benchmark."""


@dataclass(frozen=True)
class InputData:
    """A scene as MLflow's data sets are: which it is, without where it lies on a machine."""

    name: str
    digest: str
    """Eight digits, as MLflow's own; the whole ones are in the source."""
    source: str
    """JSON of an ``mlflow.data.code_dataset_source.CodeDatasetSource``."""
    profile: str
    """JSON of its sizes."""


@dataclass(frozen=True)
class RunContent:
    """All that one MLflow run is to hold."""

    name: str
    failed: bool
    seconds: float
    tags: dict[str, str]
    params: dict[str, str]
    points: tuple[Point, ...]
    n_left_out: int
    """Values that were not finite, and were left out."""
    files: tuple[tuple[Path, str], ...] = ()
    """(file, folder among the artifacts)."""
    tables: dict[str, dict[str, Any]] = field(default_factory=dict)
    """File name -> columns and data."""
    texts: dict[str, str] = field(default_factory=dict)
    """File name -> text."""
    made: dict[str, Callable[[], str]] = field(default_factory=dict)
    """File name -> what makes its text, where that takes a while: only for a run that is filled."""
    datasets: tuple[InputData, ...] = ()
    """What it was run on."""


def metric_name(protocol: str, metric: str) -> str:
    """What a protocol's metric is called in MLflow: the protocol's id is part of it."""
    return safe_key(f"{protocol}/{metric}")


def is_class_mean(protocol: str) -> bool:
    """Whether a protocol averages over classes first; those that are not known here do not."""
    return protocol in PROTOCOLS and PROTOCOLS[protocol].mean == "class"


def is_main(protocol: str, metric: str) -> bool:
    """Whether a metric is one of its protocol's main numbers."""
    return protocol in PROTOCOLS and metric in dict(PROTOCOLS[protocol].headline)


def safe_key(name: str) -> str:
    """A name that MLflow takes; one that had to change ends in four digits of its hash."""
    parts = re.sub(r"[^\w\-. :/]", "_", name, flags=re.ASCII).split("/")
    safe = "/".join(part for part in parts if part not in ("", ".", "..")).lstrip(".")
    if safe and safe == name and len(safe) <= MAX_KEY:
        return safe
    return f"{safe[: MAX_KEY - 5] or 'unnamed'}.{hashlib.sha256(name.encode()).hexdigest()[:4]}"


def safe_value(value: Any) -> str:
    """A parameter's or tag's text, cut where MLflow would refuse it."""
    text = value if isinstance(value, str) and value else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= MAX_VALUE else text[: MAX_VALUE - len(_CUT)] + _CUT


def flatten(config: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    """Nested configuration as dotted keys; lists stay whole."""
    for key, value in config.items():
        name = f"{prefix}.{key}"
        if isinstance(value, Mapping) and value:
            yield from flatten(value, name)
        else:
            yield name, value


def shown_time(result: Result) -> str:
    """When a benchmark began, UTC, short enough for MLflow's column of names.

    The year, and when that was in the reader's own time, are in the column beside it.
    """
    return datetime.fromisoformat(result.created).astimezone(UTC).strftime("%m-%d %H:%M")


_OF_A_FOLDER = re.compile(r"^(folder|captures):")
"""What the names of data sets of one's own begin with, before their path."""


def shown_datasets(result: Result) -> dict[str, str]:
    """Data set -> its name in MLflow: of a folder the last part, where that is clear."""
    names = list(dict.fromkeys(item.dataset for item in result.scenes))
    short = {name: re.split(r"[/\\]", _OF_A_FOLDER.sub("", name))[-1] or name for name in names}
    counts = Counter(short.values())
    return {name: given if counts[given] == 1 else name for name, given in short.items()}


def machine_name(environment: Environment) -> str:
    """A machine by what it computes with; it is not called by its own name, which is private."""
    parts = [f"{environment.processor}, {environment.cpu_count} CPUs", environment.gpu]
    return ", ".join(filter(None, parts))


def common_tags(result: Result) -> dict[str, str]:
    """The tags that stand on a benchmark's run and on all runs below it."""
    environment = result.environment
    revision = (environment.git_revision or "unknown")[:8]
    tags = {
        "gvr.run_id": result.run_id,
        "suite": result.suite,
        "started_by": result.started_by or "unknown",
        "machine": machine_name(environment),
        "revision": f"{revision}+" if environment.git_dirty else revision,
        "git_revision": environment.git_revision or "unknown",
        "git_dirty": json.dumps(environment.git_dirty),
        "mlflow.source.name": f"gvr run {result.suite}",
        "mlflow.source.type": "JOB" if result.started_by == "schedule" else "LOCAL",
        "python": environment.python,
        "platform": environment.platform,
        "processor": environment.processor,
        "gpu": environment.gpu or "none",
        **{f"package.{name}": version for name, version in environment.packages.items()},
        # "Acc" has several readings; the run says which one its short name stands for.
        **{f"headline.{c.key}": f"{c.metric} of {c.protocol}" for c in HEADLINE},
    }
    if environment.git_revision:
        tags["mlflow.source.git.commit"] = environment.git_revision
    return tags


def safe_items(content: Mapping[str, Any]) -> dict[str, str]:
    """Parameters or tags, names and values as MLflow takes them."""
    return {safe_key(key): safe_value(value) for key, value in content.items()}


def finite(points: Iterable[Point]) -> tuple[tuple[Point, ...], int]:
    """The points with finite values, and how many had others."""
    # MLflow would store infinity as 1.8e308, and draw it.
    all_points = list(points)
    kept = tuple(point for point in all_points if math.isfinite(point.value))
    return kept, len(all_points) - len(kept)


def as_table(lines: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Lines as columns and data, the layout of an MLflow table."""
    columns = list(dict.fromkeys(name for line in lines for name in line))
    return {"columns": columns, "data": [[line.get(name) for name in columns] for line in lines]}
