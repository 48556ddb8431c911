"""Results made by hand."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path

import numpy as np
from PIL import Image

from reports.record import Environment, QueryOutcome, Result, Row, SceneResult, StageTiming

PLANE = "gvr.in_scene_2d/1"
SOLID = "flags_3d/1"
REFUSAL = "refusal/1"

Sample = tuple[Result, list[Row], dict[str, bytes]]


def png(colour: tuple[int, int, int], size: tuple[int, int] = (8, 6)) -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.full((size[1], size[0], 3), colour, dtype=np.uint8)).save(file, "PNG")
    return file.getvalue()


def row(query: str, protocol: str, metrics: dict[str, float], **fields: object) -> Row:
    content: dict[str, object] = {
        "dataset": "rooms",
        "scene": "kitchen",
        "method": "gvr-paper",
        "text": f"the {query}",
        "target": query,
        "absent": False,
        "view": None,
    }
    return Row.model_validate(
        content | fields | {"query": query, "protocol": protocol, "metrics": metrics}
    )


def scene_result(scene: str, method: str, queries: list[str], **fields: object) -> SceneResult:
    content: dict[str, object] = {
        "dataset": "rooms",
        "scene": scene,
        "method": method,
        "status": "completed",
        "n_gaussians": 12_345,
        "n_views": 7,
        "n_patches": 70,
        "picture_size": (320, 240),
        "models": {"encoder": "conse/1", "segmenter": "felzenszwalb/1"},
        "digests": {"gaussians": "a" * 64, "views": "b" * 64},
        "prepare_seconds": 12.5,
        "query_seconds": 0.75,
        "stages": (
            StageTiming(
                stage="masks",
                seconds=10.0,
                cpu_seconds=18.0,
                peak_bytes=300 * 2**20,
                state="computed",
                key="k1",
                peak_of="stage",
            ),
            StageTiming(
                stage="encode",
                seconds=2.5,
                cpu_seconds=4.0,
                peak_bytes=500 * 2**20,
                state="cached",
                key="k2",
                peak_of="shared",
            ),
        ),
        "queries": tuple(
            QueryOutcome(
                query=name,
                found=name != "unicorn",
                location=None if name == "unicorn" else (0.1, 0.2, 0.3),
                n_flagged=0 if name == "unicorn" else 40,
                confidence=0.5,
                seconds={"localize": 0.25, "segment": 0.5},
                picture=f"pictures/{scene}-{method}-{name}.png",
            )
            for name in queries
        ),
    }
    return SceneResult.model_validate(content | fields)


def make_sample() -> Sample:
    """Result, rows, pictures.

    Kitchen, gvr-paper: cup scores Acc 1 and 0 and IoU 0.8 and 0.4 in its two views, plate Acc 1
    and IoU 0.6; so Acc is 2/3 and mIoU 0.6. The unicorn is absent, and refused. Garden: Acc 0,
    mIoU 0.2. Overall: Acc 1/3, mIoU 0.4. lift ran on the kitchen (mIoU 0.5) and failed on the
    garden.
    """
    rows = [
        row("cup", PLANE, {"acc_peak": 1.0, "iou": 0.8, "acc_at_0.25": 1.0}, view="v1"),
        row("cup", PLANE, {"acc_peak": 0.0, "iou": 0.4, "acc_at_0.25": 1.0}, view="v2"),
        row("plate", PLANE, {"acc_peak": 1.0, "iou": 0.6, "acc_at_0.25": 1.0}, view="v1"),
        row("cup", SOLID, {"iou": 0.7, "precision": 0.9, "recall": 0.75, "location_error": 0.1}),
        row("plate", SOLID, {"iou": 0.5, "precision": 0.8, "recall": 0.6}),
        row("cup", REFUSAL, {"found": 1.0, "correct": 1.0}),
        row("plate", REFUSAL, {"found": 1.0, "correct": 1.0}),
        row("unicorn", REFUSAL, {"found": 0.0, "correct": 1.0}, absent=True, target=None),
        row("tree", PLANE, {"acc_peak": 0.0, "iou": 0.2}, view="v1", scene="garden"),
        row("tree", SOLID, {"iou": 0.3}, scene="garden"),
        row("tree", REFUSAL, {"found": 1.0, "correct": 1.0}, scene="garden"),
        *(
            row("cup", PLANE, {"acc_peak": 1.0, "iou": 0.5}, view=view, method="lift")
            for view in ("v1", "v2")
        ),
        row("plate", PLANE, {"acc_peak": 1.0, "iou": 0.5}, view="v1", method="lift"),
    ]
    scenes = (
        scene_result("kitchen", "gvr-paper", ["cup", "plate", "unicorn"]),
        scene_result("garden", "gvr-paper", ["tree"]),
        scene_result("kitchen", "lift", ["cup", "plate"]),
        SceneResult(
            dataset="rooms", scene="garden", method="lift", status="failed", error="no masks"
        ),
    )
    result = Result(
        run_id="20250102T030405Z-abcdef",
        suite="smoke",
        created="2025-01-02T03:04:05+00:00",
        wall_seconds=61.5,
        config={"suite": {"seed": 0, "names": ["a", "b"]}, "note": "x" * 7000},
        environment=Environment(
            python="3.11.7",
            platform="Linux",
            processor="a processor",
            cpu_count=2,
            gpu=None,
            git_revision="0123456789abcdef0123456789abcdef01234567",
            git_dirty=False,
            packages={"numpy": "2.4.6", "torch": "2.15.0"},
        ),
        scenes=scenes,
    )
    pictures = {
        query.picture: png((10 * i % 255, 20, 30))
        for scene in scenes
        for i, query in enumerate(scene.queries)
        if query.picture is not None
    }
    return result, rows, pictures


def reseal(folder: Path) -> None:
    """Bring the sums up to date, so that only the damage under test is left."""
    names = ("result.json", "rows.jsonl")
    sums = [f"{hashlib.sha256((folder / n).read_bytes()).hexdigest()}  {n}\n" for n in names]
    (folder / "SHA256SUMS").write_text("".join(sums))
