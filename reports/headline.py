"""The three numbers that stand for a method: which protocol and metric each of them is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from gvr_core.metrics import FLAGS_3D, IN_SCENE_2D
from reports.aggregate import Aggregate
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


HEADLINE = (
    Column("acc", "Acc", IN_SCENE_2D, "acc_peak"),
    Column("miou", "mIoU", IN_SCENE_2D, "iou"),
    Column("iou_3d", "3D IoU", FLAGS_3D, "iou"),
)
"""The paper's two columns, and the overlap of the flags themselves.

"Acc" has several readings; this one is the localisation accuracy of LERF and LangSplat. The
others stand beside it under names of their own (``acc_center``, ``acc_at_0.25``, ...)."""


@dataclass(frozen=True)
class Cell:
    """One number of the headline, and what a reader has to know about it."""

    state: Literal["value", "failed", "none"]
    value: float = 0.0
    partial: bool = False
    """Not averaged over all (query, view) pairs, or over all scenes."""


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
    if mean is None:
        return Cell("none")
    return Cell("value", mean.mean, partial=mean.coverage < 1.0)


def overall_cell(
    result: Result, summary: Aggregate, dataset: str, method: str, column: Column
) -> Cell:
    """The unweighted mean over the scenes of a data set; the paper's "overall"."""
    found = summary.overall(dataset, method, column.protocol)
    mean = None if found is None else found.metrics.get(column.metric)
    if mean is None:
        return Cell("none")
    cells = [
        scene_cell(result, summary, dataset, scene, method, column)
        for scene in scene_names(result, dataset)
    ]
    partial = any(cell.partial or cell.state != "value" for cell in cells)
    return Cell("value", mean.scene_macro, partial=partial)


def dataset_names(result: Result) -> list[str]:
    """The data sets of a run, in its order."""
    return list(dict.fromkeys(scene.dataset for scene in result.scenes))


def scene_names(result: Result, dataset: str) -> list[str]:
    """The scenes of a data set, in the run's order."""
    return list(dict.fromkeys(s.scene for s in result.scenes if s.dataset == dataset))


def method_names(result: Result, dataset: str) -> list[str]:
    """The methods run on a data set, in the run's order."""
    return list(dict.fromkeys(s.method for s in result.scenes if s.dataset == dataset))
