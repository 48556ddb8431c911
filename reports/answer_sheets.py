"""What was answered where nobody knows the truth: scenes of one's own, which nothing scores."""

from __future__ import annotations

from collections.abc import Sequence

from reports.formats import NONE
from reports.headline import dataset_names
from reports.record import QueryOutcome, Result, Row
from reports.sheet import Sheet


def unscored_datasets(result: Result, rows: Sequence[Row]) -> list[str]:
    """The data sets of a run that have answers and no scores, in its order."""
    scored = {row.dataset for row in rows}
    answered = {scene.dataset for scene in result.scenes if scene.queries}
    return [name for name in dataset_names(result) if name in answered - scored]


def answer_sheets(result: Result, datasets: Sequence[str]) -> list[Sheet]:
    """One row for each answer.

    Args:
        result: The run.
        datasets: The data sets that are wanted.
    """
    sheets = []
    for dataset in datasets:
        scenes = [scene for scene in result.scenes if scene.dataset == dataset]
        rows = [
            (scene.method, scene.scene, query.text or query.query, *_answer(query))
            for scene in scenes
            for query in scene.queries
        ]
        rows += [(s.method, s.scene, NONE, "failed", NONE, NONE) for s in scenes if s.error]
        sheets.append(
            Sheet(
                title=f"{dataset}: what was answered",
                columns=("method", "scene", "query", "found", "Gaussians", "location"),
                rows=tuple(rows),
                n_names=3,
                notes=("Nobody stated the truth of these scenes, so nothing is scored.",),
            )
        )
    return sheets


def _answer(query: QueryOutcome) -> tuple[str, str, str]:
    place = NONE
    if query.location is not None:
        place = " ".join(f"{coordinate:.3g}" for coordinate in query.location)
    return "yes" if query.found else "no", f"{query.n_flagged:,}", place
