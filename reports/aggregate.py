"""From rows to the numbers of a table.

Every summary belongs to one protocol; numbers of two protocols are never averaged together.
Three averages are kept apart, because published evaluators differ in which one they print:

- *flat*: over all rows (query, view) of a scene;
- *class macro*: over the rows of each query target, then over targets (Gaussian Grouping);
- *scene macro*: flat per scene, then unweighted over scenes. This is what the paper calls
  overall; *micro*, the flat mean over the rows of all scenes, stands beside it.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence

from pydantic import BaseModel, ConfigDict

from gvr_core.metrics import REFUSAL
from reports.record import Row, SceneResult


class _Summary(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


class MetricMean(_Summary):
    """One metric on one scene."""

    mean: float
    """Flat, over the rows that define it."""
    class_macro: float
    n: int
    """Rows that define it."""
    n_undefined: int
    """Rows of present objects that leave it out."""
    n_classes: int
    coverage: float
    """``n`` over the (query, view) pairs that any method of the run has a number for under this
    protocol, absent queries aside. Below 1, methods were not averaged over the same pairs."""


class SceneSummary(_Summary):
    """One method on one scene under one protocol."""

    dataset: str
    scene: str
    method: str
    protocol: str
    n_rows: int
    n_absent: int
    """Rows left out because the object is known not to be in the scene."""
    metrics: dict[str, MetricMean]


class OverallMean(_Summary):
    """One metric over the scenes of a data set."""

    scene_macro: float
    micro: float
    class_macro: float
    """Unweighted mean over scenes of the class macro."""
    n: int
    n_scenes: int


class DatasetSummary(_Summary):
    """One method on one data set under one protocol."""

    dataset: str
    method: str
    protocol: str
    scenes: tuple[str, ...]
    """Scenes with rows."""
    missing: tuple[str, ...]
    """Scenes of the data set in this run that this method has no rows for: it failed there."""
    n_rows: int
    n_absent: int
    metrics: dict[str, OverallMean]


class RefusalSummary(_Summary):
    """How a method answered queries for objects that are not in the scene, and that are."""

    dataset: str
    scene: str
    method: str
    n_absent: int
    n_refused: int
    """Absent objects that were refused, as is right."""
    n_present: int
    n_present_refused: int
    """Present objects that were refused, wrongly."""


class Aggregate(_Summary):
    """All summaries of a run, in the order in which scenes and methods first appear."""

    scenes: tuple[SceneSummary, ...]
    datasets: tuple[DatasetSummary, ...]
    refusals: tuple[RefusalSummary, ...]

    def scene(self, dataset: str, scene: str, method: str, protocol: str) -> SceneSummary | None:
        """The summary of one scene, or None where there are no rows."""
        key = (dataset, scene, method, protocol)
        return next(
            (s for s in self.scenes if (s.dataset, s.scene, s.method, s.protocol) == key), None
        )

    def overall(self, dataset: str, method: str, protocol: str) -> DatasetSummary | None:
        """The summary of one data set, or None where there are no rows."""
        key = (dataset, method, protocol)
        return next((d for d in self.datasets if (d.dataset, d.method, d.protocol) == key), None)

    def refusal(self, dataset: str, scene: str, method: str) -> RefusalSummary | None:
        """The refusals on one scene, or None where there are no rows."""
        key = (dataset, scene, method)
        return next((r for r in self.refusals if (r.dataset, r.scene, r.method) == key), None)


def aggregate(rows: Sequence[Row], scenes: Iterable[SceneResult] = ()) -> Aggregate:
    """Summarise rows.

    Args:
        rows: The rows of one run.
        scenes: What the run set out to do; scenes without rows are then reported as missing.
    """
    groups: dict[tuple[str, str, str, str], list[Row]] = defaultdict(list)
    pairs: dict[tuple[str, str, str], set[tuple[str, str | None]]] = defaultdict(set)
    for row in rows:
        groups[row.dataset, row.scene, row.method, row.protocol].append(row)
        if _counts(row) and row.metrics:
            pairs[row.dataset, row.scene, row.protocol].add((row.query, row.view))
    summaries = tuple(
        _scene_summary(key, group, len(pairs[key[0], key[1], key[3]]))
        for key, group in groups.items()
    )
    planned: dict[str, dict[str, None]] = defaultdict(dict)
    for dataset, scene in (
        *((s.dataset, s.scene) for s in scenes),
        *((s.dataset, s.scene) for s in summaries),
    ):
        planned[dataset][scene] = None
    return Aggregate(
        scenes=summaries,
        datasets=_dataset_summaries(summaries, groups, planned),
        refusals=tuple(_refusals(key, group) for key, group in groups.items() if key[3] == REFUSAL),
    )


def _counts(row: Row) -> bool:
    # Nothing can overlap with an absent object; only the answer "not here" is scored on it.
    return not row.absent or row.protocol == REFUSAL


def _mean(values: Sequence[float]) -> float:
    # fsum is exact before its one rounding, so the mean does not depend on the rows' order.
    return math.fsum(values) / len(values)


def _names(rows: Iterable[Row]) -> list[str]:
    return list(dict.fromkeys(name for row in rows for name in row.metrics))


def _scene_summary(
    key: tuple[str, str, str, str], rows: Sequence[Row], n_expected: int
) -> SceneSummary:
    counted = [row for row in rows if _counts(row)]
    metrics = {}
    for name in _names(counted):
        classes: dict[str, list[float]] = defaultdict(list)
        for row in counted:
            if name in row.metrics:
                # Queries without a named target are classes of their own.
                label = f"query {row.query}" if row.target is None else f"target {row.target}"
                classes[label].append(row.metrics[name])
        values = [value for group in classes.values() for value in group]
        metrics[name] = MetricMean(
            mean=_mean(values),
            class_macro=_mean([_mean(group) for group in classes.values()]),
            n=len(values),
            n_undefined=len(counted) - len(values),
            n_classes=len(classes),
            coverage=len(values) / n_expected,
        )
    dataset, scene, method, protocol = key
    return SceneSummary(
        dataset=dataset,
        scene=scene,
        method=method,
        protocol=protocol,
        n_rows=len(rows),
        n_absent=len(rows) - len(counted),
        metrics=metrics,
    )


def _dataset_summaries(
    summaries: Sequence[SceneSummary],
    groups: Mapping[tuple[str, str, str, str], Sequence[Row]],
    planned: Mapping[str, Mapping[str, None]],
) -> tuple[DatasetSummary, ...]:
    by_dataset: dict[tuple[str, str, str], list[SceneSummary]] = defaultdict(list)
    for summary in summaries:
        by_dataset[summary.dataset, summary.method, summary.protocol].append(summary)
    found = []
    for (dataset, method, protocol), parts in by_dataset.items():
        names = list(dict.fromkeys(name for part in parts for name in part.metrics))
        metrics = {}
        for name in names:
            having = [part for part in parts if name in part.metrics]
            values = [
                row.metrics[name]
                for part in having
                for row in groups[dataset, part.scene, method, protocol]
                if _counts(row) and name in row.metrics
            ]
            metrics[name] = OverallMean(
                scene_macro=_mean([part.metrics[name].mean for part in having]),
                micro=_mean(values),
                class_macro=_mean([part.metrics[name].class_macro for part in having]),
                n=len(values),
                n_scenes=len(having),
            )
        present = tuple(part.scene for part in parts)
        found.append(
            DatasetSummary(
                dataset=dataset,
                method=method,
                protocol=protocol,
                scenes=present,
                missing=tuple(name for name in planned[dataset] if name not in present),
                n_rows=sum(part.n_rows for part in parts),
                n_absent=sum(part.n_absent for part in parts),
                metrics=metrics,
            )
        )
    return tuple(found)


def _refusals(key: tuple[str, str, str, str], rows: Sequence[Row]) -> RefusalSummary:
    absent = [row for row in rows if row.absent]
    present = [row for row in rows if not row.absent]
    return RefusalSummary(
        dataset=key[0],
        scene=key[1],
        method=key[2],
        n_absent=len(absent),
        n_refused=sum(_refused(row) for row in absent),
        n_present=len(present),
        n_present_refused=sum(_refused(row) for row in present),
    )


def _refused(row: Row) -> bool:
    return row.metrics.get("found") == 0.0
