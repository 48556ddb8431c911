"""Runs whose lines are compared, made by hand."""

from __future__ import annotations

from collections.abc import Sequence

from record_samples import PLANE, REFUSAL, SOLID, make_sample, row, scene_result

from reports.record import QueryOutcome, Result, Row, SceneResult

SCENES = ("kitchen", "garden", "attic")


def outcome(name: str, confidence: float) -> QueryOutcome:
    return QueryOutcome(
        query=name,
        found=confidence > 0.5,
        location=(0.0, 0.0, 0.0),
        n_flagged=3,
        confidence=confidence,
        seconds={"query": 0.25, "segment": 0.5},
    )


def scene_line(
    scene: str,
    label: str,
    ious: dict[str, float],
    models: str = "",
    reference: str | None = None,
    absent: float = 0.4,
    present: float = 0.7,
    **fields: object,
) -> tuple[SceneResult, list[Row]]:
    """One line on one scene: 3D IoU by query, and one absent query, "unicorn"."""
    suffix = f" · {models}" if models else ""
    name = label + suffix
    answers = (*(outcome(query, present) for query in ious), outcome("unicorn", absent))
    own = {"label": label, "model_set": models, "queries": answers}
    own["reference"] = None if reference is None else reference + suffix
    result = scene_result(scene, name, [], **fields).model_copy(update=own)
    place = {"scene": scene, "method": name}
    rows = [row("unicorn", REFUSAL, {"found": float(absent > 0.5)}, absent=True, **place)]
    for query, iou in ious.items():
        within = {"within_radius": float(iou > 0.35)}
        rows += [
            row(query, SOLID, {"iou": iou} | within, **place),
            row(query, PLANE, {"iou": iou / 2, "acc_peak": float(iou > 0.5)}, view="v1", **place),
            row(query, REFUSAL, {"found": float(present > 0.5)}, **place),
        ]
    return result, rows


def make_run(parts: Sequence[tuple[SceneResult, list[Row]]]) -> tuple[Result, list[Row]]:
    result, _, _ = make_sample()
    scenes = tuple(part for part, _ in parts)
    return result.model_copy(update={"scenes": scenes}), [r for _, rows in parts for r in rows]


def small_run() -> tuple[Result, list[Row]]:
    """Three lines on three scenes.

    3D IoU of base 0.4 and 0.6, 0.5, 0.9; "w/o votes" is 0.1 lower everywhere, "other" 0.2 higher
    on the first query of the kitchen and has failed in the attic.
    """
    base = {"kitchen": {"cup": 0.4, "plate": 0.6}, "garden": {"tree": 0.5}, "attic": {"box": 0.9}}
    parts = []
    for scene, ious in base.items():
        parts.append(scene_line(scene, "base", ious))
        less = {query: iou - 0.1 for query, iou in ious.items()}
        parts.append(scene_line(scene, "w/o votes", less, reference="base", absent=0.9))
        if scene == "attic":
            failed = SceneResult(
                dataset="rooms",
                scene=scene,
                method="other",
                status="failed",
                error="no masks",
                label="other",
                reference="base",
            )
            parts.append((failed, []))
            continue
        more = {query: iou + 0.2 * (query == "cup") for query, iou in ious.items()}
        parts.append(scene_line(scene, "other", more, reference="base", prepare_seconds=30.0))
    return make_run(parts)


def large_run(n_scenes: int = 10, n_variants: int = 20) -> tuple[Result, list[Row]]:
    """Two model sets, two methods, and so many variants of the second; long names."""
    parts = []
    for i in range(n_scenes):
        scene = f"hidden_under_a_table_{i}"
        for models in ("oracle", "onboard"):
            parts.append(scene_line(scene, "gvr-paper", {"cup": 0.1}, models))
            parts.append(scene_line(scene, "gvr-robust", {"cup": 1.0}, models, "gvr-paper"))
            parts += [
                scene_line(
                    scene, f"w/o canonical negative no {j}", {"cup": 0.5}, models, "gvr-robust"
                )
                for j in range(n_variants)
            ]
    return make_run(parts)
