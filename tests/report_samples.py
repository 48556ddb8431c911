"""A result with evidence and names that try to be more than names, for the pages made of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from reports.evidence import (
    AgreedPlace,
    Camera,
    FinalPicture,
    Picture,
    QueryEvidence,
    SceneEvidence,
    VirtualPicture,
    Vote,
    cloud_of,
    outline_path,
    picture_fields,
    to_webp,
)
from reports.record import Environment, QueryOutcome, Result, Row, SceneResult, StageTiming
from reports.result_io import write_result

PLANE, SOLID, REFUSAL = "gvr.in_scene_2d/1", "flags_3d/1", "refusal/1"

EVIL_TEXT = "</script><script>window.owned=1</script><img src=x onerror='window.owned=2'>"
EVIL_SCENE = '"><svg onload=window.owned=3>&amp;{{7*7}}'
EVIL_METHOD = "<b>bold</b> $\\frac{1}{0}$"
SIZE = (120, 90)


def picture(shade: int, size: tuple[int, int] = SIZE) -> dict[str, object]:
    rgb = np.full((size[1], size[0], 3), shade, np.uint8)
    rgb[20:50, 30:70] = (200, 60, 40)
    return picture_fields(to_webp(rgb), size)


def outline() -> str:
    mask = np.zeros((SIZE[1], SIZE[0]), np.bool_)
    mask[20:50, 30:70] = True
    return outline_path(mask, SIZE)


def evidence(queries: list[str], n_views: int = 10) -> SceneEvidence:
    rng = np.random.default_rng(1)
    cameras = tuple(
        Camera(name=f"view_{i:02d}", position=(float(i), 2.0, 3.0), picture=Picture(**picture(i)))
        for i in range(n_views)
    )
    steps = []
    for query in queries:
        votes = tuple(
            Vote(
                view=i,
                score=0.9 - 0.05 * i,
                point=(0.1 * i, 0.0, 0.5),
                place=-1 if i % 3 == 2 else 0,
                outline=outline(),
                pixel=(50.0, 35.0),
            )
            for i in range(n_views)
        )
        virtual = [VirtualPicture(role="bev", outline=outline(), **picture(90))]
        virtual += [VirtualPicture(role="ring", outline=o, **picture(9)) for o in (outline(), None)]
        steps.append(
            QueryEvidence(
                query=query,
                votes=votes,
                places=(AgreedPlace(location=(0.2, 0.0, 0.5), radius=0.3, weight=0.7),),
                virtual=tuple(virtual),
                finals=tuple(
                    FinalPicture(view=view, test=True, outline=outline(), **picture(150))
                    for view in ("v1", "v2")
                ),
            )
        )
    points = rng.normal(size=(50, 3))
    return SceneEvidence(
        up=(0.0, 0.0, 1.0),
        cloud=cloud_of(points, rng.integers(0, 255, (50, 3))),
        cameras=cameras,
        queries=tuple(steps),
    )


def row(place: dict[str, str], query: str, protocol: str, **fields: object) -> Row:
    content: dict[str, object] = {
        "text": f"the {query}",
        "target": query,
        "absent": False,
        "view": None,
        "metrics": {},
    }
    return Row.model_validate(content | place | {"query": query, "protocol": protocol} | fields)


def make_result(
    n_queries: int = 3,
    scenes: tuple[str, ...] = ("kitchen", "garden"),
    methods: tuple[str, ...] = ("gvr-paper", "w/o RFL"),
    shift: float = 0.0,
    run_id: str = "20260101T000000Z-000001",
    texts: dict[str, str] | None = None,
    with_evidence: bool = True,
    failed: tuple[str, str] | None = None,
) -> tuple[Result, list[Row], dict[str, bytes]]:
    """Query i of scene s scores an IoU of 0.1 + 0.1 i + 0.05 s, 0.2 lower for the second method.

    ``shift`` is added to all; Acc is 1 where the IoU is above 0.25; the last query is absent.
    """
    rows: list[Row] = []
    results: list[SceneResult] = []
    files: dict[str, bytes] = {}
    for s, scene in enumerate(scenes):
        for m, method in enumerate(methods):
            place = {"dataset": "rooms", "scene": scene, "method": method}
            line = {"label": method, "reference": methods[0] if m else None}
            if failed == (scene, method):
                results.append(
                    SceneResult(**place, **line, status="failed", error=f"no {EVIL_TEXT}")
                )
                continue
            names = [f"thing-{i}" for i in range(n_queries)]
            for i, query in enumerate(names):
                words = {"text": (texts or {}).get(query, f"the {query}")}
                absent = i == n_queries - 1
                about = {**words, "absent": absent, "target": None if absent else query}
                said = {"found": float(not absent), "correct": 1.0}
                rows.append(row(place, query, REFUSAL, metrics=said, **about))
                if absent:
                    continue
                iou = min(1.0, max(0.0, 0.1 + 0.1 * i + 0.05 * s - 0.2 * m + shift))
                rows.append(row(place, query, SOLID, metrics={"iou": iou}, **about))
                for view in ("v1", "v2"):
                    scores = {"iou": iou, "acc_peak": float(iou > 0.25)}
                    rows.append(row(place, query, PLANE, metrics=scores, view=view, **about))
            path = None
            if with_evidence:
                path = f"evidence/rooms/s{s}/m{m}.json"
                files[path] = evidence(names).model_dump_json().encode()
            results.append(_scene(place, line, names, path))
    result = Result(
        run_id=run_id,
        suite="smoke",
        created="2026-01-01T00:00:00+00:00",
        wall_seconds=61.5,
        config={"suite": {"seed": 0}},
        environment=Environment(
            python="3.11.7",
            platform="Linux",
            processor="a processor",
            cpu_count=2,
            gpu=None,
            git_revision="0123456789abcdef0123456789abcdef01234567",
            git_dirty=False,
            packages={"numpy": "2.4.6"},
        ),
        scenes=tuple(results),
    )
    return result, rows, files


def written(folder: Path, **options: object) -> Path:
    """The folder of :func:`make_result`'s result."""
    result, rows, files = make_result(**options)  # type: ignore[arg-type]
    return write_result(folder / result.run_id, result, rows, files)


def evil(folder: Path) -> Path:
    """A result in which every name that others choose tries to run a script."""
    return written(
        folder,
        scenes=(EVIL_SCENE, "garden"),
        methods=("gvr-paper", EVIL_METHOD),
        texts={"thing-0": EVIL_TEXT},
        failed=("garden", EVIL_METHOD),
    )


def _scene(
    place: dict[str, str], line: dict[str, str | None], names: list[str], path: str | None
) -> SceneResult:
    stages = tuple(
        StageTiming(
            stage=stage,
            seconds=seconds,
            cpu_seconds=2 * seconds,
            peak_bytes=int(megabytes * 1e6),
            state="computed",
            key="k",
        )
        for stage, seconds, megabytes in (("masks", 10.0, 300), ("segment", 2.5, 512))
    )
    queries = tuple(
        QueryOutcome(
            query=name,
            found=i < len(names) - 1,
            location=(0.1, 0.2, 0.3),
            n_flagged=40 + i,
            confidence=0.9 - 0.01 * i,
            seconds={"query": 0.25, "segment": 0.5},
        )
        for i, name in enumerate(names)
    )
    return SceneResult(
        **place,  # type: ignore[arg-type]
        **line,  # type: ignore[arg-type]
        status="completed",
        n_gaussians=12_345,
        n_views=10,
        picture_size=(320, 240),
        models={"encoder": "conse/1"},
        digests={"gaussians": "a" * 64},
        prepare_seconds=12.5,
        query_seconds=0.75,
        stages=stages,
        queries=queries,
        evidence=path,
    )
