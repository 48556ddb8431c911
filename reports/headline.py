"""The numbers that stand for a method: which protocol and metric each of them is.

A data set with protocols of its own is headed by these, each in a table of its own, and by ours
after them. All other data sets have the one table of :data:`HEADLINE`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from gvr_core.metrics import FLAGS_3D, IN_SCENE_2D, REFUSAL
from gvr_core.protocols import PROTOCOLS
from gvr_core.protocols.base import ProtocolSpec
from reports.aggregate import Aggregate, SceneSummary
from reports.record import Result


@dataclass(frozen=True)
class Column:
    """A number of the headline table."""

    key: str
    """Its name in MLflow."""
    title: str
    """Its name in tables."""
    protocol: str
    metric: str
    mean: Literal["flat", "class"] = "flat"
    """Which mean of a scene it is: over (query, view) pairs, or over the views of each target
    first and then over targets."""


HEADLINE = (
    Column("acc", "Acc", IN_SCENE_2D, "acc_peak"),
    Column("miou", "mIoU", IN_SCENE_2D, "iou"),
    Column("iou_3d", "3D IoU", FLAGS_3D, "iou"),
)
"""The paper's two columns, and the overlap of the flags themselves.

"Acc" has several readings; this one is the localisation accuracy of LERF and LangSplat. The
others stand beside it under names of their own (``acc_center``, ``acc_at_0.25``, ...)."""

OUR_PROTOCOLS = (IN_SCENE_2D, FLAGS_3D, REFUSAL)
"""Protocols that belong to no data set."""


@dataclass(frozen=True)
class Cell:
    """One number of the headline, and what a reader has to know about it."""

    state: Literal["value", "failed", "none"]
    value: float = 0.0
    partial: bool = False
    """Not averaged over all (query, view) pairs, or over all scenes."""
    n: int = 0
    """(query, view) pairs that it was averaged over."""
    n_expected: int = 0
    """(query, view) pairs that any method of the run was asked for."""

    @property
    def coverage(self) -> float:
        """Evaluated over expected pairs; 1 where none were expected."""
        return self.n / self.n_expected if self.n_expected else 1.0


def headings(summary: Aggregate, dataset: str) -> tuple[tuple[Column, ...], ...]:
    """The headline tables of a data set, each as its columns.

    Args:
        summary: The averages of a run; which protocols a data set has, its rows say.
        dataset: Name of the data set.

    Returns:
        One table for each protocol that is the data set's own, in the order of its rows, then one
        of those of our columns that have rows. :data:`HEADLINE` alone where there are no
        protocols but ours.
    """
    ids = list(dict.fromkeys(s.protocol for s in summary.scenes if s.dataset == dataset))
    own = [PROTOCOLS[name] for name in ids if name in PROTOCOLS and name not in OUR_PROTOCOLS]
    own = [spec for spec in own if spec.headline]
    if not own:
        return (HEADLINE,)
    tables = [columns_of(spec) for spec in own]
    ours = tuple(column for column in HEADLINE if column.protocol in ids)
    return (*tables, ours) if ours else tuple(tables)


def columns_of(spec: ProtocolSpec) -> tuple[Column, ...]:
    """The headline of a protocol as columns."""
    family = spec.id.partition("/")[0]
    return tuple(
        Column(f"{family}.{metric}", title, spec.id, metric, spec.mean)
        for metric, title in spec.headline
    )


def is_own(columns: Sequence[Column]) -> bool:
    """Whether these are the columns of a protocol of the data set's own."""
    return columns[0].protocol not in OUR_PROTOCOLS


def scene_cell(
    result: Result, summary: Aggregate, dataset: str, scene: str, method: str, column: Column
) -> Cell:
    """The number of one method on one scene."""
    for item in result.scenes:
        if (item.dataset, item.scene, item.method) == (dataset, scene, method) and (
            item.status == "failed"
        ):
            return Cell("failed")
    found = summary.scene(dataset, scene, method, column.protocol)
    mean = None if found is None else found.metrics.get(column.metric)
    expected = _expected(summary, dataset, scene, column.protocol)
    if mean is None:
        return Cell("none", n_expected=expected)
    value = mean.class_macro if column.mean == "class" else mean.mean
    return Cell("value", value, mean.coverage < 1.0, mean.n, expected)


def overall_cell(
    result: Result, summary: Aggregate, dataset: str, method: str, column: Column
) -> Cell:
    """The unweighted mean over the scenes of a data set; the paper's "overall"."""
    found = summary.overall(dataset, method, column.protocol)
    mean = None if found is None else found.metrics.get(column.metric)
    scenes = scene_names(result, dataset)
    expected = sum(_expected(summary, dataset, scene, column.protocol) for scene in scenes)
    if mean is None:
        return Cell("none", n_expected=expected)
    cells = [scene_cell(result, summary, dataset, scene, method, column) for scene in scenes]
    partial = any(cell.partial or cell.state != "value" for cell in cells)
    value = mean.class_macro if column.mean == "class" else mean.scene_macro
    return Cell("value", value, partial, mean.n, expected)


def _expected(summary: Aggregate, dataset: str, scene: str, protocol: str) -> int:
    """The (query, view) pairs of a scene that any method was asked for under a protocol."""
    return max(
        (
            _expected_by(part)
            for part in summary.scenes
            if (part.dataset, part.scene, part.protocol) == (dataset, scene, protocol)
        ),
        default=0,
    )


def _expected_by(part: SceneSummary) -> int:
    # Where no pair has a number, the rows are what was asked for.
    asked = (round(mean.n / mean.coverage) for mean in part.metrics.values())
    return max(asked, default=part.n_rows - part.n_absent)


def dataset_names(result: Result) -> list[str]:
    """The data sets of a run, in its order."""
    return list(dict.fromkeys(scene.dataset for scene in result.scenes))


def scene_names(result: Result, dataset: str) -> list[str]:
    """The scenes of a data set, in the run's order."""
    return list(dict.fromkeys(s.scene for s in result.scenes if s.dataset == dataset))


def method_names(result: Result, dataset: str) -> list[str]:
    """The methods run on a data set, in the run's order."""
    return list(dict.fromkeys(s.method for s in result.scenes if s.dataset == dataset))
