"""The paper's table for a run: method x scene x (Acc, mIoU), overall, and what was published.

Measured numbers and published ones never share a sheet. Below the measured sheets of a data set
that numbers were published on stand the published ones, each method marked †, then the times
published with them, then the differences of the two where a measured method is one of those.

A scene of another origin may be written in a data set's layout, even under the name of one of its
scenes. So unless all scenes of a data set are taken for the originals, published rows and
differences carry the line "published on the original data, not on these scenes". Scenes that do
not bear the name of a published one have no differences.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from reports.aggregate import Aggregate
from reports.formats import NONE
from reports.headline import (
    Cell,
    Column,
    dataset_names,
    headings,
    is_own,
    method_names,
    overall_cell,
    scene_cell,
    scene_names,
)
from reports.headline_sheets import headline_sheets, subject_of, wide_headline_sheets
from reports.protocol_guard import check_same_protocol
from reports.published import Family, PublishedRow, families_of
from reports.published_sheets import MARK, family_sheets, lay_out
from reports.record import Result
from reports.result_check import ResultError
from reports.sheet import Sheet

MEASURED_AS = {"gvr-paper": "GVR"}
"""Label of a measured line -> name of the published method that it reproduces. Any other label
stands for the published method of the same name, as predictions of others bear it."""


@dataclass(frozen=True)
class _Setting:
    """What the sheets of one data set need to know."""

    result: Result
    summary: Aggregate
    dataset: str
    wide: bool
    original: bool | None

    @property
    def scenes(self) -> list[str]:
        return scene_names(self.result, self.dataset)

    def cell(self, scene: str, method: str, column: Column) -> Cell:
        return scene_cell(self.result, self.summary, self.dataset, scene, method, column)


def paper_sheets(
    result: Result,
    summary: Aggregate,
    wide: bool = False,
    original: bool | None = None,
    datasets: Sequence[str] | None = None,
) -> list[Sheet]:
    """The headline of each data set, and below it what was published on it.

    Args:
        result: The run.
        summary: Its averages.
        wide: A line per method with all numbers of a scene in one cell, as documents have it;
            else a line per number, as fits a terminal.
        original: Whether the scenes are the original data of their data sets; as the result has
            it where None.
        datasets: The data sets that are wanted; all of the run where None.
    """
    sheets = []
    for dataset in dataset_names(result) if datasets is None else datasets:
        measured = wide_headline_sheets if wide else headline_sheets
        sheets += measured(result, summary, [dataset])
        sheets += published_sheets(result, summary, dataset, wide, original)
    return sheets


def published_datasets(result: Result) -> list[str]:
    """The data sets of a run that numbers were published on."""
    return [name for name in dataset_names(result) if families_of(name)]


def published_sheets(
    result: Result,
    summary: Aggregate,
    dataset: str,
    wide: bool = False,
    original: bool | None = None,
) -> list[Sheet]:
    """What was published on a data set, and how far measured numbers are from it.

    Args:
        result: The run.
        summary: Its averages.
        dataset: Name of the data set.
        wide: As in :func:`paper_sheets`.
        original: As in :func:`paper_sheets`.

    Returns:
        None for a data set that nothing was published on, and where the run has no numbers of a
        protocol that published ones may stand beside.
    """
    if original is None and all(s.original for s in result.scenes if s.dataset == dataset):
        original = True
    setting = _Setting(result, summary, dataset, wide, original)
    tables = [columns for columns in headings(summary, dataset) if is_own(columns)]
    sheets = []
    for family in families_of(dataset):
        beside = [columns for columns in tables if family.stands_beside(columns[0].protocol)]
        if not beside:
            continue
        notes = _of_the_data(setting, family, beside[0])
        titles = {column.metric: column.title for column in beside[0]}
        sheets += family_sheets(family, titles, setting.scenes, wide, notes)
        for columns in beside:
            if original is not False:
                sheets += _difference_sheets(setting, family, columns, notes)
    return sheets


def _of_the_data(setting: _Setting, family: Family, columns: Sequence[Column]) -> list[str]:
    """What has to be said of the data wherever a published number stands."""
    strange = [scene for scene in setting.scenes if scene not in family.scenes]
    counts = []
    for scene in setting.scenes:
        methods = method_names(setting.result, setting.dataset)
        here = max(setting.cell(scene, method, columns[0]).n_expected for method in methods)
        if here and here != family.pairs.get(scene, here):
            counts.append(f"{scene} {here} for {family.pairs[scene]}")
    if setting.original and not strange:
        line = f"{MARK} published on these scenes; not measured here."
    else:
        line = f"{MARK} published on the original data, not on these scenes"
        unknown = setting.original is None and not strange and not counts
        line += "; should these be the originals, the run does not know it." if unknown else "."
    if counts:
        return [line, f"Labelled (prompt, view) pairs, not as published: {', '.join(counts)}."]
    return [line]


def _difference_sheets(
    setting: _Setting, family: Family, columns: Sequence[Column], notes: Sequence[str]
) -> list[Sheet]:
    """Measured minus published under one protocol; nothing where no method is in both."""
    shown = [column for column in columns if column.metric in family.metrics]
    labels = {s.method: s.shown_label for s in setting.result.scenes if s.dataset == family.dataset}
    known = {row.method.casefold(): row for row in family.rows if row.relative_to is None}
    scenes = [scene for scene in setting.scenes if scene in family.scenes]
    lines, refused, unknown = [], [], []
    for method in method_names(setting.result, setting.dataset):
        row = known.get(MEASURED_AS.get(labels[method], labels[method]).casefold())
        if row is None or not scenes:
            continue
        if row.protocol is None:
            unknown.append(row.method)
        else:
            try:
                check_same_protocol(columns[0].protocol, row.protocol, f"{method} - {row.method}")
            except ResultError as error:
                refused.append(f"Not compared: {error.message}.")
                continue
        places = _differences(setting, family, row, method, shown)
        lines.append((f"{method} - {row.method}{MARK}", places))
    if not lines and not refused:
        return []
    said = [*notes, *dict.fromkeys(refused)]
    if lines:
        said.append("Overall: only where the run has the scenes of the published overall.")
    if any("*" in text for _, places in lines for place in places for text in place):
        said.append("* not every expected pair was evaluated.")
    if unknown:
        names = ", ".join(dict.fromkeys(unknown))
        said.append(
            f"Under which protocol {names} was scored is not known, so the difference is not one "
            "of methods alone."
        )
    return lay_out(
        f"{subject_of(family.dataset, columns)}, measured minus published{MARK}",
        [column.title for column in shown],
        scenes,
        lines,
        said,
        setting.wide,
        "points",
    )


def _differences(
    setting: _Setting, family: Family, row: PublishedRow, method: str, columns: Sequence[Column]
) -> list[list[str]]:
    """Each scene that bears a published name, then overall: the difference of each column."""
    places = [
        [
            _difference(setting.cell(scene, method, c), row.scenes.get(scene, {}).get(c.metric))
            for c in columns
        ]
        for scene in setting.scenes
        if scene in family.scenes
    ]
    overall = []
    for column in columns:
        cell = overall_cell(setting.result, setting.summary, setting.dataset, method, column)
        scored = [s for s in setting.scenes if setting.cell(s, method, column).state == "value"]
        averaged = [s for s, values in row.scenes.items() if column.metric in values]
        same = set(scored) == set(setting.scenes) == set(averaged or family.scenes)
        overall.append(_difference(cell, row.overall.get(column.metric) if same else None))
    return [*places, overall]


def _difference(cell: Cell, published: float | None) -> str:
    if cell.state != "value" or published is None:
        return NONE
    return f"{100 * cell.value - published:+.1f}{'*' if cell.partial else ''}"
