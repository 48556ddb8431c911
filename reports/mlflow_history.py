"""Benchmarks over time: an experiment beside that of the runs, where a run is a line's history.

MLflow draws a line chart of the points of one run, and of single values of many runs no more than
bars. So each line (method and models) of a suite on a data set has one run that gets a point of
every benchmark, at the time when it began, and MLflow's charts show the nights one after the other,
all lines in one chart. Benchmarks that asked something else (fewer scenes, a limit), or ran on
another machine, are another line.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any

from reports.aggregate import Aggregate, MetricMean
from reports.headline import dataset_names, method_names
from reports.mlflow_line import overall_line, short_names
from reports.mlflow_run import (
    Point,
    finite,
    is_class_mean,
    is_main,
    machine_name,
    metric_name,
    safe_items,
    safe_key,
    shown_datasets,
)
from reports.mlflow_store import batches_of, experiment_id, locked, search_all, sqlite_database
from reports.record import Result, SceneResult

if TYPE_CHECKING:
    from mlflow import MlflowClient
    from mlflow.entities import Run

ALWAYS = "overall/n_failed"
"""A metric that every benchmark gives; its points say which benchmarks a history has."""
_BATCH = 1000


@dataclass(frozen=True)
class LinePoints:
    """What a benchmark adds to the history of one line."""

    name: str
    tags: dict[str, str]
    points: tuple[Point, ...]
    """`ALWAYS` is the last, so that a history that has it has the others too."""


def history_experiment(experiment: str) -> str:
    """Name of the experiment with the histories of another."""
    return f"{experiment} over time"


def line_histories(result: Result, summary: Aggregate) -> list[LinePoints]:
    """What a benchmark adds to histories; nothing where it only scored an older one again."""
    if "scored_from" in result.config:
        return []
    return [
        _line(result, summary, dataset, method)
        for dataset in dataset_names(result)
        for method in method_names(result, dataset)
    ]


def _line(result: Result, summary: Aggregate, dataset: str, method: str) -> LinePoints:
    items = [item for item in result.scenes if (item.dataset, item.method) == (dataset, method)]
    line = overall_line(result, summary, dataset, method)
    points = [Point(f"overall/{name}", line[name]) for name in _COUNTS if name in line]
    if not line["n_failed"]:  # a mean over fewer scenes would be another number
        for part in summary.datasets:
            if (part.dataset, part.method) == (dataset, method):
                for metric in part.metrics:
                    for name in _names(part.protocol, metric):
                        points.append(Point(f"overall/{_flat(name)}", line[name]))
    points += _scene_points(summary, dataset, method)
    kept, _ = finite([*points, Point(ALWAYS, line["n_failed"])])
    limit = result.config.get("limit")
    shown = shown_datasets(result)[dataset]
    asked = f"{len(items)} scene{'s' * (len(items) > 1)}"
    asked += f", {limit} of the queries" if limit else ""
    tags = {
        "kind": "history",
        "suite": result.suite,
        "dataset": dataset,
        "method": method,
        "label": items[0].shown_label,
        **({"model_set": items[0].model_set} if items[0].model_set else {}),
        "machine": machine_name(result.environment),
        "asked": asked,
        "series": _series(result, dataset, method, items),
        "mlflow.note.content": f"{method} on {shown}: a point for each benchmark of {result.suite}",
    }
    return LinePoints(f"{method} · {shown} ({asked})", safe_items(tags), kept)


_COUNTS = ("n_scenes", "prepare_seconds", "query_seconds")


def _series(result: Result, dataset: str, method: str, items: Sequence[SceneResult]) -> str:
    """What two benchmarks have in common whose numbers make one line in a chart."""
    asked = [
        *(result.suite, dataset, method, machine_name(result.environment)),
        sorted(item.scene for item in items),
        *(result.config.get("limit"), result.config.get("exclude_eval_views")),
    ]
    return hashlib.sha256(json.dumps(asked).encode()).hexdigest()[:16]


def _names(protocol: str, metric: str) -> list[str]:
    """What a number is called here: by its short name, else by that of its protocol."""
    main = [metric_name(protocol, metric)] if is_main(protocol, metric) else []
    return short_names(protocol, metric) or main


def _scene_points(summary: Aggregate, dataset: str, method: str) -> Iterator[Point]:
    for part in summary.scenes:
        if (part.dataset, part.method) == (dataset, method):
            for metric, mean in part.metrics.items():
                for name in _names(part.protocol, metric):
                    key = safe_key(f"scene/{part.scene}/{_flat(name)}")
                    yield Point(key, _own(part.protocol, mean))


def _flat(name: str) -> str:
    """Without slashes, at each of which MLflow's charts would begin a section."""
    return name.replace("/", " ")


def _own(protocol: str, mean: MetricMean) -> float:
    return mean.class_macro if is_class_mean(protocol) else mean.mean


def write_histories(
    client: MlflowClient, uri: str, experiment: str, result: Result, lines: Sequence[LinePoints]
) -> int:
    """Add a benchmark's points to the histories; those that are there stay as they are.

    Args:
        client: Of the MLflow to fill.
        uri: Its tracking URI.
        experiment: The experiment of the benchmark's runs.
        result: The benchmark.
        lines: Its points.

    Returns:
        How many histories got a point. None do where the experiment is in MLflow's trash: who put
        it there does not want it.
    """
    found = experiment_id(client, uri, history_experiment(experiment)) if lines else None
    if found is None:
        return 0
    database = sqlite_database(uri)
    if database is None:
        return _write(client, found, result, lines)
    with locked(database.with_name(f".{database.name}.history.lock")):
        return _write(client, found, result, lines)


def _write(client: Any, experiment: str, result: Result, lines: Sequence[LinePoints]) -> int:
    from mlflow.entities import Metric

    start = round(datetime.fromisoformat(result.created).timestamp() * 1000)
    known = _known(client, experiment, result.suite)
    n_added = 0
    for line in lines:
        run = known.get(line.tags["series"])
        steps: dict[int, int] = {}
        if run is None:
            run = client.create_run(
                experiment, start_time=start, tags=line.tags, run_name=line.name
            )
        else:
            history = client.get_metric_history(run.info.run_id, ALWAYS)
            steps = {point.timestamp: point.step for point in history}
        if start in steps:
            continue
        step = max(steps.values(), default=0) + 1
        metrics = [Metric(point.key, point.value, start, step) for point in line.points]
        for some in batches_of(metrics, _BATCH):
            client.log_batch(run.info.run_id, metrics=some)
        client.set_terminated(run.info.run_id, "FINISHED", max([*steps, start]))
        n_added += 1
    return n_added


def _known(client: Any, experiment: str, suite: str) -> dict[str, Run]:
    """The histories of a suite; of doubles, which a lost answer leaves behind, the fullest."""
    known: dict[str, Run] = {}
    filter_string = f"tags.kind = 'history' and tags.suite = '{suite}'"
    for run in search_all(client, experiment, filter_string):
        series = run.data.tags.get("series", "")
        other = known.get(series)
        if other is None:
            known[series] = run
            continue
        kept, spare = sorted((other, run), key=lambda one: len(one.data.metrics), reverse=True)
        known[series] = kept
        client.delete_run(spare.info.run_id)
    return known
