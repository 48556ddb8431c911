"""Lines of a run side by side: each one's figures, and how far it is from the one it refers to."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gvr_core.metrics import FLAGS_3D, IN_SCENE_2D, REFUSAL
from reports.auroc import auroc
from reports.bootstrap import Difference, Estimate, interval
from reports.headline import method_names, scene_names
from reports.protocol_guard import Pair, paired_rows, values_by_scene
from reports.record import Result, Row, SceneResult

Values = Mapping[str, Mapping[Pair, float]]
"""Scene -> pair -> value of one metric."""


@dataclass(frozen=True)
class ComparedLine:
    """The figures of one method with one set of models on one data set."""

    name: str
    """``method`` of its results."""
    label: str
    """The method's name without the model set."""
    model_set: str
    reference: str | None
    """Label of the line that it is compared with."""
    iou_3d: Estimate | None
    difference: Difference | None
    """Its 3D IoU minus the reference's, over the queries that both were scored on."""
    by_scene: dict[str, float]
    """Scene -> mean 3D IoU."""
    miou: Estimate | None
    acc: Estimate | None
    within_radius: Estimate | None
    """Share of present objects whose L_3D lies within the object's radius."""
    auroc: Estimate | None
    """Of confidence, for present against absent objects."""
    n_absent: int
    n_refused: int
    """Absent objects that were refused, as is right."""
    n_present: int
    n_present_refused: int
    """Present objects that were refused, wrongly."""
    prepare_seconds: float | None
    """Mean over the scenes that it completed."""
    query_seconds: float | None
    """Mean over the scenes that it completed."""
    failed: tuple[str, ...]
    """Scenes on which it failed."""
    n_missing: int
    """Queries whose 3D IoU other lines of its model set have, and this one has not."""

    @property
    def lowest(self) -> tuple[str, float] | None:
        """The scene with the lowest mean 3D IoU, and that mean."""
        if not self.by_scene:
            return None
        return min(self.by_scene.items(), key=lambda item: item[1])


def has_references(result: Result) -> bool:
    """Whether any line of the run is compared with another."""
    return any(scene.reference for scene in result.scenes)


def model_sets(result: Result, dataset: str) -> list[str]:
    """Labels of the sets of models that ran on a data set, in the run's order."""
    return list(dict.fromkeys(s.model_set for s in result.scenes if s.dataset == dataset))


def compare(result: Result, rows: Sequence[Row], dataset: str) -> list[ComparedLine]:
    """The figures of every line on a data set, in the run's order.

    Every mean is over the rows of each scene, then unweighted over scenes.

    Args:
        result: The run.
        rows: Its rows.
        dataset: Name of the data set.
    """
    results: dict[str, list[SceneResult]] = defaultdict(list)
    for scene in result.scenes:
        if scene.dataset == dataset:
            results[scene.method].append(scene)
    mine: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        if row.dataset == dataset:
            mine[row.method].append(row)
    scenes = scene_names(result, dataset)
    names = method_names(result, dataset)
    overlaps = {name: values_by_scene(mine[name], FLAGS_3D, "iou", scenes) for name in names}
    known: dict[str, set[tuple[str, Pair]]] = defaultdict(set)
    for name in names:
        known[results[name][0].model_set] |= _pairs(overlaps[name])
    labels = {name: results[name][0].shown_label for name in names}
    return [
        _line(results[name], mine, scenes, overlaps, known[results[name][0].model_set], labels)
        for name in names
    ]


def _line(
    results: Sequence[SceneResult],
    rows_of: Mapping[str, Sequence[Row]],
    scenes: Sequence[str],
    overlaps: Mapping[str, Values],
    known: set[tuple[str, Pair]],
    labels: Mapping[str, str],
) -> ComparedLine:
    first = results[0]
    own, reference = overlaps[first.method], first.reference
    rows = rows_of[first.method]
    difference = None
    if reference is not None and own and overlaps.get(reference):
        difference = paired_rows(rows, rows_of[reference], "iou", FLAGS_3D, scenes)
    done = [scene for scene in results if scene.status == "completed"]
    answered = [scene for scene in done if scene.queries]
    refusals = [row for row in rows if row.protocol == REFUSAL]
    refused = [row for row in refusals if row.metrics.get("found") == 0.0]
    return ComparedLine(
        name=first.method,
        label=first.shown_label,
        model_set=first.model_set,
        reference=None if reference is None else labels.get(reference, reference),
        iou_3d=_mean(own),
        difference=difference,
        by_scene={scene: sum(pairs.values()) / len(pairs) for scene, pairs in own.items()},
        miou=_mean(values_by_scene(rows, IN_SCENE_2D, "iou", scenes)),
        acc=_mean(values_by_scene(rows, IN_SCENE_2D, "acc_peak", scenes)),
        within_radius=_mean(values_by_scene(rows, FLAGS_3D, "within_radius", scenes)),
        auroc=auroc(_confidences(done, refusals)),
        n_absent=sum(row.absent for row in refusals),
        n_refused=sum(row.absent for row in refused),
        n_present=sum(not row.absent for row in refusals),
        n_present_refused=sum(not row.absent for row in refused),
        prepare_seconds=_plain_mean([scene.prepare_seconds for scene in done]),
        query_seconds=_plain_mean([scene.query_seconds for scene in answered]),
        failed=tuple(scene.scene for scene in results if scene.status == "failed"),
        n_missing=len(known - _pairs(own)),
    )


def _confidences(
    results: Sequence[SceneResult], refusals: Sequence[Row]
) -> dict[str, tuple[list[float], list[float]]]:
    """Scene -> confidences of the queries for present and for absent objects."""
    absent = {(row.scene, row.query): row.absent for row in refusals}
    found: dict[str, tuple[list[float], list[float]]] = {}
    for scene in results:
        kinds = found.setdefault(scene.scene, ([], []))
        for query in scene.queries:
            is_absent = absent.get((scene.scene, query.query))
            if is_absent is not None:  # else nobody knows whether the object is there
                kinds[int(is_absent)].append(query.confidence)
    return found


def _pairs(values: Values) -> set[tuple[str, Pair]]:
    return {(scene, pair) for scene, pairs in values.items() for pair in pairs}


def _mean(values: Values) -> Estimate | None:
    return interval({scene: list(pairs.values()) for scene, pairs in values.items()})


def _plain_mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None
