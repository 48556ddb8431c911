"""Writing scenes in the project's own layout (see `datasets.native`)."""

from __future__ import annotations

import shutil
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.colmap import write_colmap_text
from datasets.images import write_png
from datasets.native_records import (
    MODEL,
    PLY,
    SceneFile,
    check_distinct,
    check_labels,
    check_name,
    check_queries,
    check_scene_file,
)
from gvr_core.atomic import atomic_write, sync_folder
from gvr_core.cameras import Camera
from gvr_core.errors import DatasetError
from gvr_core.gaussians import SH_C0, Gaussians
from gvr_core.scene import Query
from gvr_core.splat_io import write_ply

MAX_POINTS = 5000
"""Points of the COLMAP model: an even choice of the Gaussians' centres, for other tools."""


@dataclass(frozen=True, eq=False)
class Picture:
    """One view to write."""

    name: str
    """Unique in the scene; becomes a file name."""
    camera: Camera
    rgb: NDArray[np.uint8]
    """(H, W, 3), the size of the camera."""
    masks: Mapping[str, NDArray[np.bool_]] | None = None
    """Object -> mask (H, W) for a test view; None for a knowledge view."""


def write_scene(
    folder: Path,
    *,
    dataset: str,
    name: str,
    gaussians: Gaussians,
    pictures: Sequence[Picture],
    objects: Sequence[str],
    labels: NDArray[np.int16],
    queries: Sequence[Query],
    up: tuple[float, float, float] | None,
    provenance: str,
    recipe: str = "",
    replace: bool = False,
) -> None:
    """Write a scene: it appears under its name whole, or not at all.

    Args:
        folder: The scene's folder.
        dataset: Name of the data set it is made for.
        name: Name of the scene.
        gaussians: N Gaussians.
        pictures: All views; those with masks become the test views.
        objects: Names of the labelled objects.
        labels: (N,) int16 index into ``objects``, -1 for the rest.
        queries: Queries whose targets are among the objects.
        up: (3,) up direction, world frame; None where the scene is not to state one.
        provenance: Where the content comes from, and under which licence.
        recipe: sha256 of what a generated scene is made from.
        replace: Whether a scene that is there already gives way.

    Raises:
        DatasetError: for a name that cannot be a file name, labels, masks or queries that do not
            fit, or a folder that exists and is not to be replaced.
        CameraFormatError: for a view name that COLMAP cannot hold.
        OSError: if a file cannot be written.
    """
    record = SceneFile(
        dataset=dataset,
        name=name,
        up=up,
        objects=tuple(objects),
        test_views=tuple(p.name for p in pictures if p.masks is not None),
        provenance=provenance,
        recipe=recipe,
    )
    check_scene_file(record, folder / "scene.json")
    check_queries(queries, objects, folder / "queries.json")
    check_labels(labels, len(gaussians), len(objects), folder / "labels.npy")
    _check_pictures(pictures, objects, folder)
    if folder.exists() and not replace:
        raise DatasetError("there is something already", path=folder, accepted="a new folder")
    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary = folder.parent / f".{folder.name}.{uuid.uuid4().hex}.tmp"
    try:
        _write_files(temporary, record, gaussians, pictures, labels, queries)
        _swap_in(temporary, folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _write_files(
    folder: Path,
    record: SceneFile,
    gaussians: Gaussians,
    pictures: Sequence[Picture],
    labels: NDArray[np.int16],
    queries: Sequence[Query],
) -> None:
    """All files of a scene, in a folder that nobody reads yet."""
    write_ply(folder / PLY, gaussians)
    chosen = np.unique(np.linspace(0, len(gaussians) - 1, MAX_POINTS).astype(int))
    colours = np.rint(255 * np.clip(0.5 + SH_C0 * gaussians.sh[chosen, 0], 0, 1))
    cameras = [(f"{picture.name}.png", picture.camera) for picture in pictures]
    write_colmap_text(folder / MODEL, cameras, gaussians.means[chosen], colours.astype(np.uint8))
    for picture in pictures:
        write_png(folder / "images" / f"{picture.name}.png", picture.rgb)
        for target, mask in (picture.masks or {}).items():
            if mask.any():
                write_png(folder / "test_masks" / picture.name / f"{target}.png", mask)
    with atomic_write(folder / "labels.npy") as file:
        np.save(file, labels, allow_pickle=False)
    items = ",\n".join("  " + query.model_dump_json() for query in queries)
    with atomic_write(folder / "queries.json") as file:
        file.write(f"[\n{items}\n]\n".encode())
    with atomic_write(folder / "scene.json") as file:
        file.write((record.model_dump_json(indent=2) + "\n").encode())


def _swap_in(temporary: Path, folder: Path) -> None:
    """Give a finished folder its name; an older one of that name is set aside, then deleted."""
    old = folder.parent / f".{folder.name}.{uuid.uuid4().hex}.old"
    if folder.exists():
        folder.rename(old)
    temporary.rename(folder)
    shutil.rmtree(old, ignore_errors=True)
    sync_folder(folder.parent)


def _check_pictures(pictures: Sequence[Picture], objects: Sequence[str], folder: Path) -> None:
    """Names, sizes and masks of the views."""
    for picture in pictures:
        check_name(picture.name, "view", folder)
        size = (picture.camera.height, picture.camera.width)
        shapes = {"picture": picture.rgb.shape[:2]}
        for target, mask in (picture.masks or {}).items():
            if target not in objects:
                raise DatasetError(
                    f"view {picture.name!r} has a mask of {target!r}",
                    path=folder,
                    accepted=", ".join(objects) or "no masks: the scene has no objects",
                )
            shapes[f"mask of {target!r}"] = mask.shape
        for what, shape in shapes.items():
            if shape != size:
                raise DatasetError(
                    f"view {picture.name!r}: the {what} has shape {shape}",
                    path=folder,
                    accepted=f"{size}, as its camera has",
                )
    check_distinct([picture.name for picture in pictures], "view", folder)
    if all(picture.masks is not None for picture in pictures):
        raise DatasetError(
            "no knowledge view", path=folder, accepted="one picture or more without masks"
        )
