"""A scene of one's own: a splat file, cameras, and any questions; no ground truth."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from datasets.base import GroundTruth, SceneData
from datasets.cameras_file import read_cameras
from gvr_core.atomic import file_digest
from gvr_core.cameras import Camera
from gvr_core.errors import CameraFormatError, ConfigError
from gvr_core.scene import Query, Scene, View
from gvr_core.splat_io import read_splat

OWN = "own"
"""Name of the data set that such scenes belong to."""

MAX_SIDE = 800
"""Views are rendered with at most so many pixels on the longer side: photographs of 4000 pixels
would cost a hundred times as much and show no other objects."""


def own_scene(
    splat: Path | str,
    cameras: Path | str,
    texts: Sequence[str],
    max_views: int | None = None,
    max_side: int = MAX_SIDE,
) -> SceneData:
    """A splat file and cameras as a scene.

    Args:
        splat: A .ply or .splat file.
        cameras: An inria ``cameras.json``, or a folder with a COLMAP model.
        texts: The questions.
        max_views: Keep only so many cameras, evenly spaced in name order; None keeps all.
        max_side: Longest side of the rendered views, pixels.

    Raises:
        SplatFormatError: for the splat file.
        CameraFormatError: for the cameras.
        ConfigError: for an empty question, or no view to keep.
    """
    if max_views is not None and max_views < 1:
        raise ConfigError(f"--max-views is {max_views}", accepted="1 or more")
    splat, cameras = Path(splat), Path(cameras)
    gaussians = read_splat(splat)
    named = read_cameras(cameras)
    if not named:
        raise CameraFormatError("holds no camera", path=cameras, accepted="one camera or more")
    if max_views is not None and len(named) > max_views:
        named = [named[i * len(named) // max_views] for i in range(max_views)]
    views = tuple(View(_stem(name), at_most(camera, max_side)) for name, camera in named)
    return SceneData(
        Scene(OWN, splat.stem, gaussians, views),
        own_queries(texts),
        GroundTruth(objects=(), test_views=()),
        {
            "gaussians": file_digest(splat),
            "views": _cameras_digest(views),
            "queries": _digest(list(texts)),
            "truth": _digest([]),
        },
    )


def _stem(name: str) -> str:
    path = PurePosixPath(name)
    return str(path.with_suffix("")) if path.suffix.lower() in (".jpg", ".jpeg", ".png") else name


def own_queries(texts: Sequence[str]) -> tuple[Query, ...]:
    """Questions whose answers nobody knows: ``q0``, ``q1``, ...

    Raises:
        ConfigError: for a text that is empty or too long.
    """
    for text in texts:
        if not text.strip() or len(text) > 400:
            raise ConfigError(f"the query {text[:60]!r}", accepted="1 to 400 characters")
    return tuple(Query(id=f"q{i}", text=text) for i, text in enumerate(texts))


def at_most(camera: Camera, side: int = MAX_SIDE) -> Camera:
    """The camera, smaller where its longer side has more pixels than ``side``."""
    scale = side / max(camera.width, camera.height)
    if scale >= 1:
        return camera
    return camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))


def _cameras_digest(views: Sequence[View]) -> str:
    described = [
        [
            view.name,
            view.camera.K.tolist(),
            view.camera.world_to_camera.tolist(),
            view.camera.width,
            view.camera.height,
        ]
        for view in views
    ]
    return _digest(described)


def _digest(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
