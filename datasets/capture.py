"""A capture: a trained splat, and the posed photographs that it was trained on.

This is what the folders of real benchmarks share, whatever their labels look like::

    <scene>/
      images/                        photographs; or only images_2/, images_4/, images_8/
      sparse/0/                      COLMAP, or cameras.json (inria), or transforms.json
      output/, point_cloud/, ...     the trained splat (see `datasets.splat_places`)
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.camera_checks import is_folder
from datasets.cameras_file import CameraSource, find_cameras
from datasets.picture_folder import FOLDERS, PictureFolder, picture_size
from datasets.splat_places import find_splat, model_folder
from gvr_core.cameras import Camera
from gvr_core.errors import DatasetError, some_of
from gvr_core.gaussians import Gaussians
from gvr_core.splat_io import read_splat

SCALES = (2, 4, 8)
"""Pictures may be smaller than their cameras by these factors: what tools make as images_2 etc."""

SEEN_SAMPLE = 2000
"""Gaussians that are projected into each image to tell whether splat and cameras fit."""

SEEN_LEAST = 0.005
"""An image that shows a smaller share of the splat than this shows next to nothing of it."""

BLIND_MOST = 0.25
"""Share of such images above which the reader is told: a photographed scene has hardly any."""


@dataclass(frozen=True, eq=False)
class CaptureImage:
    """One registered image."""

    name: str
    """Relative POSIX path below the folder of pictures, with its ending; as the camera file has
    it where the picture is not there."""
    camera: Camera
    """As large as the picture, where that is there."""
    path: Path | None
    """The photograph, where it is there."""


@dataclass(frozen=True, eq=False)
class CapturedImages:
    """The photographs of a capture, without its splat."""

    images: tuple[CaptureImage, ...]
    """Registered images, in name order."""
    camera_files: tuple[Path, ...]
    """The files whose content the cameras are made from, for digests."""
    unregistered: tuple[str, ...]
    """Pictures that have no camera, in name order."""
    notes: tuple[str, ...]
    """Counted repairs, and what was chosen where there was a choice."""


@dataclass(frozen=True, eq=False)
class Capture:
    """A trained splat and its posed photographs, in one world frame."""

    gaussians: Gaussians
    ply: Path
    """The splat file that was read."""
    images: tuple[CaptureImage, ...]
    """Registered images, in name order."""
    camera_files: tuple[Path, ...]
    """The files whose content the cameras are made from, for digests."""
    unregistered: tuple[str, ...]
    """Pictures that have no camera, in name order."""
    notes: tuple[str, ...]
    """Counted repairs, and what was chosen where there was a choice."""


def read_capture(
    folder: Path, scene: str, splat: Path | None = None, splats: Path | None = None
) -> Capture:
    """Read the splat and the cameras of a folder, and check that they belong together.

    Args:
        folder: The scene's folder.
        scene: The scene's name; its splat may be called so.
        splat: The splat file, or its training's output folder, where it is named.
        splats: A folder of splats by scene, where that is named.

    Raises:
        DatasetError: for no such folder, no splat or several that differ, a picture whose size
            does not fit its camera, or a splat that no image shows.
        CameraFormatError: for no cameras, or cameras that cannot be used.
        SplatFormatError: for a splat that cannot be used.
    """
    folder = Path(folder)
    if not is_folder(folder):
        raise DatasetError("no such folder", path=folder, accepted="the folder of a scene")
    ply = find_splat(folder, scene, splat, splats)
    captured = read_images(folder, model_folder(ply))
    gaussians = read_splat(ply)
    seen = _check_seen(gaussians, captured.images, ply)
    return Capture(
        gaussians,
        ply,
        captured.images,
        captured.camera_files,
        captured.unregistered,
        (*captured.notes, *seen),
    )


def read_images(folder: Path, model: Path | None = None) -> CapturedImages:
    """Read the cameras of a folder, and find their photographs.

    Args:
        folder: The scene's folder.
        model: The output folder of the splat's training, which may hold a cameras.json.

    Raises:
        DatasetError: for a picture whose size does not fit its camera, or that two cameras mean.
        CameraFormatError: for no cameras, or cameras that cannot be used.
    """
    source = find_cameras(folder, () if model is None else (model,))
    pictures = PictureFolder.of(source.folder, source.pictures)
    images, scaled, renamed = [], Counter[int](), 0
    exact = {name: pictures.exact(name) for name, _ in source.cameras}
    taken = {picture: name for name, picture in exact.items() if picture is not None}
    for name, camera in source.cameras:
        picture = exact[name] or pictures.like(name, source.has_endings)
        path = pictures.elsewhere(name) if picture is None else pictures.path(picture)
        if path is None:
            images.append(CaptureImage(name, camera, None))
            continue
        shown = picture or path.relative_to(source.folder).as_posix()
        if taken.setdefault(shown, name) != name:
            raise DatasetError(
                f"the cameras of {taken[shown]!r} and {name!r} mean this picture",
                path=path,
                accepted="a picture of its own for each camera",
            )
        renamed += picture is not None and exact[name] is None and source.has_endings
        fitted, factor = _fitted(camera, picture_size(path), path)
        scaled[factor] += factor > 1
        images.append(CaptureImage(shown, fitted, path))
    images.sort(key=lambda image: image.name)
    notes = (*source.notes, *_notes(source, pictures, images, scaled, renamed))
    unregistered = tuple(sorted(set(pictures.names) - set(taken)))
    return CapturedImages(tuple(images), source.files, unregistered, notes)


def _fitted(camera: Camera, size: tuple[int, int], path: Path) -> tuple[Camera, int]:
    """The camera with as many pixels as its picture, and by how much it became smaller."""
    if size == (camera.width, camera.height):
        return camera, 1
    for factor in SCALES:
        # Halves of odd sizes are rounded up by some tools and down by others.
        if abs(camera.width / factor - size[0]) < 1 and abs(camera.height / factor - size[1]) < 1:
            return camera.resized(*size), factor
    raise DatasetError(
        f"the picture has {size[0]} x {size[1]} pixels",
        path=path,
        accepted=f"{camera.width} x {camera.height}, as its camera has, or a"
        f" {', '.join(f'1/{factor}' for factor in SCALES)} of it",
    )


def _notes(
    source: CameraSource,
    pictures: PictureFolder,
    images: list[CaptureImage],
    scaled: Counter[int],
    renamed: int,
) -> list[str]:
    """What was put right or is missing."""
    notes = []
    if pictures.folder is None:
        notes.append(f"no folder of pictures ({', '.join(FOLDERS)})")
    elif pictures.folder.name not in (FOLDERS[0], source.pictures):
        notes.append(f"no folder images: pictures are taken from {pictures.folder.name}")
    missing = [image.name for image in images if image.path is None]
    if missing and pictures.folder is not None:
        notes.append(
            f"{len(missing)} of {len(images)} registered images have no picture: {some_of(missing)}"
        )
    notes += [
        f"{count} pictures have 1/{factor} of their cameras' size: cameras rescaled"
        for factor, count in sorted(scaled.items())
        if count
    ]
    if renamed:
        notes.append(f"{renamed} pictures have another ending than their cameras say")
    return notes


def _check_seen(gaussians: Gaussians, images: tuple[CaptureImage, ...], ply: Path) -> list[str]:
    """Refuse a splat that no image shows, and tell of images that show next to nothing of it.

    A splat whose training moved, turned or scaled the world (nerfstudio does) renders as nothing
    or as nonsense through the cameras of the capture.
    """
    chosen = np.unique(np.linspace(0, len(gaussians) - 1, SEEN_SAMPLE).astype(int))
    shares = []
    for image in images:
        pixels, _ = image.camera.project(gaussians.means[chosen])
        size = (image.camera.width, image.camera.height)
        # Pixels of what is behind the camera are NaN, and no comparison with NaN holds.
        shares.append(((pixels >= 0) & (pixels < size)).all(axis=1).mean())
    if not any(shares):
        raise DatasetError(
            f"none of the {len(images)} registered images shows anything of the splat",
            path=ply,
            accepted="a splat in the world frame of the capture's cameras",
        )
    blind = sum(share < SEEN_LEAST for share in shares)
    if blind <= BLIND_MOST * len(shares):
        return []
    return [
        f"{blind} of {len(images)} images show next to nothing of the splat: is it in the world"
        " frame of these cameras?"
    ]
