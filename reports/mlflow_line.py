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
    """A line as metrics of the benchmark's run.

    Only main numbers have their other means there, and what has a short name has no other.
    """
    group = line_group(result, dataset, method)
    main, doubled = _names(summary, dataset, method)
    first = [c.key for c in HEADLINE if c.key in line]  # MLflow's table keeps the order
    for name in dict.fromkeys([*first, *line]):
        value = line[name]
        ending = next((e for e in _OTHER_MEANS if name.endswith(e)), "")
        plain = name.removesuffix(ending)
        shown = plain not in doubled and (not ending or plain in main)
        if shown and isinstance(value, (int, float)):
            yield Point(safe_key(f"{group}/{name}"), value)


def _names(summary: Aggregate, dataset: str, method: str) -> tuple[set[str], set[str]]:
    """The names of a line's main numbers, and the long names of those that have a short one."""
    main: set[str] = set()
    doubled: set[str] = set()
    for part in summary.datasets:
        if (part.dataset, part.method) == (dataset, method):
            for metric in part.metrics:
                name, short = metric_name(part.protocol, metric), short_names(part.protocol, metric)
                main |= {name, *short} if short or is_main(part.protocol, metric) else set()
                doubled |= {name} if short else set()
    return main, doubled


def short_names(protocol: str, metric: str) -> list[str]:
    """The headline names of a metric; most have none."""
    return [c.key for c in HEADLINE if (c.protocol, c.metric) == (protocol, metric)]
