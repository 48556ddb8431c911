"""The numbers of a line (a method with its models) over the scenes of a data set."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from reports.aggregate import Aggregate
from reports.headline import HEADLINE
from reports.mlflow_run import (
    Point,
    is_class_mean,
    is_main,
    metric_name,
    safe_key,
    shown_datasets,
)
from reports.record import Result

_OTHER_MEANS = ("_flat", "_class_macro", "_micro")


def line_group(result: Result, dataset: str, method: str) -> str:
    """What a line's metrics begin with: MLflow takes no name with the dot between parts."""
    item = next(s for s in result.scenes if (s.dataset, s.method) == (dataset, method))
    name = shown_datasets(result)[dataset]
    return "/".join(filter(None, (name, item.model_set, item.shown_label)))


def overall_line(result: Result, summary: Aggregate, dataset: str, method: str) -> dict[str, Any]:
    """A line of the table of a benchmark: every metric with all its means, counts and times."""
    line: dict[str, Any] = {"dataset": dataset, "method": method}
    for part in summary.datasets:
        if (part.dataset, part.method) == (dataset, method):
            for metric, mean in part.metrics.items():
                name = metric_name(part.protocol, metric)
                for alias in dict.fromkeys([name, *short_names(part.protocol, metric)]):
                    own = mean.class_macro if is_class_mean(part.protocol) else mean.scene_macro
                    line[alias] = own
                    line[f"{alias}_flat"] = mean.scene_macro
                    line[f"{alias}_class_macro"] = mean.class_macro
                    line[f"{alias}_micro"] = mean.micro
    of_line = [item for item in result.scenes if (item.dataset, item.method) == (dataset, method)]
    done = [item for item in of_line if item.status == "completed"]
    line["n_scenes"] = len(done)
    line["n_failed"] = len(of_line) - len(done)
    if done:
        line["prepare_seconds"] = sum(item.prepare_seconds for item in done) / len(done)
        line["query_seconds"] = sum(item.query_seconds for item in done) / len(done)
    return line


def line_points(
    result: Result, summary: Aggregate, dataset: str, method: str, line: dict[str, Any]
) -> Iterator[Point]:
    """A line as metrics of the benchmark's run; only main numbers have their other means there."""
    group = line_group(result, dataset, method)
    main = main_names(summary, dataset, method)
    for name, value in line.items():
        ending = next((e for e in _OTHER_MEANS if name.endswith(e)), "")
        if isinstance(value, (int, float)) and (not ending or name.removesuffix(ending) in main):
            yield Point(safe_key(f"{group}/{name}"), value)


def main_names(summary: Aggregate, dataset: str, method: str) -> set[str]:
    """The names in MLflow of a line's main numbers."""
    names: set[str] = set()
    for part in summary.datasets:
        if (part.dataset, part.method) == (dataset, method):
            for metric in part.metrics:
                names |= set(short_names(part.protocol, metric))
                if is_main(part.protocol, metric):
                    names.add(metric_name(part.protocol, metric))
    return names


def short_names(protocol: str, metric: str) -> list[str]:
    """The headline names of a metric; most have none."""
    return [c.key for c in HEADLINE if (c.protocol, c.metric) == (protocol, metric)]
