"""COLMAP models: cameras, poses and points, read as text or binary and written as text.

The format: https://colmap.github.io/format.html. Rotations and translations there are world to
camera with OpenCV axes, as here. Only cameras without distortion are read.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from datasets.camera_checks import image_name, in_name_order, is_file, is_folder, posed_camera
from datasets.colmap_binary import read_cameras_binary, read_images_binary, read_points_binary
from datasets.colmap_text import read_cameras_text, read_images_text, read_points_text
from gvr_core.atomic import atomic_write
from gvr_core.cameras import Camera
from gvr_core.errors import CameraFormatError

_OTHER_FILES = ("cameras.bin", "images.bin", "points3D.bin", "rigs.txt", "frames.txt")


@dataclass(frozen=True, eq=False)
class ColmapModel:
    """A COLMAP model: who saw what from where."""

    cameras: Mapping[str, Camera]
    """Cameras by image name (relative POSIX path), in name order."""
    points3D: NDArray[np.float64] | None = None
    """(P, 3) points, world frame; None where the folder has no file of points."""
    colours: NDArray[np.uint8] | None = None
    """(P, 3) colours of the points, 0 to 255."""


def has_colmap_model(folder: Path) -> bool:
    """Whether a folder holds the two files that a COLMAP model needs."""
    return _suffix(folder) is not None


def colmap_files(folder: Path) -> tuple[Path, ...]:
    """The files that the cameras of a model are read from; none where there is no model."""
    suffix = _suffix(folder)
    return () if suffix is None else tuple(folder / f"{x}{suffix}" for x in ("cameras", "images"))


def read_colmap_model(folder: Path | str) -> ColmapModel:
    """Read a COLMAP model; the binary form where both forms are there, as COLMAP does.

    Args:
        folder: Holds ``cameras``, ``images`` and perhaps ``points3D``, each ``.bin`` or ``.txt``.

    Raises:
        DistortedCameraError: if a camera has distortion.
        CameraFormatError: if the files are missing or not as the format says, an image names a
            camera that is not there, or there is no image.
    """
    folder = Path(folder)
    suffix = _suffix(folder)
    if suffix is None:
        raise CameraFormatError(
            "no COLMAP model here" if is_folder(folder) else "no such folder",
            path=folder,
            accepted="a folder with cameras.bin and images.bin, or cameras.txt and images.txt",
        )
    binary = suffix == ".bin"
    images = folder / f"images{suffix}"
    intrinsics = (read_cameras_binary if binary else read_cameras_text)(folder / f"cameras{suffix}")
    named = []
    for pose in (read_images_binary if binary else read_images_text)(images):
        if pose.camera not in intrinsics:
            known = ", ".join(map(str, sorted(intrinsics)[:20]))
            raise CameraFormatError(
                f"unknown camera {pose.camera}",
                path=images,
                place=pose.place,
                accepted=f"an id of cameras{suffix}: {known or 'it has none'}",
            )
        camera = intrinsics[pose.camera]
        posed = posed_camera(camera.K, pose.world_to_camera, camera.size, images, pose.place)
        named.append((pose.name, posed, pose.place))
    cameras = dict(in_name_order(named, images))
    points = folder / f"points3D{suffix}"
    if not is_file(points):
        return ColmapModel(cameras)
    return ColmapModel(cameras, *(read_points_binary if binary else read_points_text)(points))


def write_colmap_text(
    folder: Path | str,
    images: Sequence[tuple[str, Camera]],
    points: ArrayLike = (),
    colours: ArrayLike = (),
) -> None:
    """Write a COLMAP model as text; cameras with equal intrinsics share one entry.

    Each file appears whole or not at all, ``images.txt`` last: without it there is no model.

    Args:
        folder: Made where it is missing.
        images: Image names and cameras, in the order of the ids they get.
        points: (P, 3) points, world frame, finite.
        colours: (P, 3) colours, 0 to 255; black where none are given.

    Raises:
        CameraFormatError: for no image at all, a name that cannot be used, is there twice or
            holds a space (COLMAP would read its first word), points and colours that do not
            belong together, or a folder with files of another model that readers would take
            instead of these or mix with them.
        OSError: if a file cannot be written.
    """
    folder = Path(folder)
    older = [name for name in _OTHER_FILES if (folder / name).exists()]
    if older:
        raise CameraFormatError(
            f"the folder holds {', '.join(older)} of another model",
            path=folder,
            accepted="a folder without these",
        )
    ids: dict[tuple[float, ...], int] = {}
    lines, named = [], []
    for number, (name, camera) in enumerate(images, start=1):
        place = f"image {number}"
        name = image_name(name, folder, place)
        if any(character.isspace() for character in name):
            raise CameraFormatError(
                f"the image name {name!r} holds a space",
                path=folder,
                place=place,
                accepted="names without spaces",
            )
        size = (int(camera.width), int(camera.height))
        key = (*size, *camera.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist())
        camera_id = ids.setdefault(key, len(ids) + 1)
        x, y, z, w = Rotation.from_matrix(camera.world_to_camera[:3, :3]).as_quat().tolist()
        t = camera.world_to_camera[:3, 3].tolist()
        lines.append(f"{number} {_joined([w, x, y, z, *t])} {camera_id} {name}\n\n")
        named.append((name, camera, place))
    in_name_order(named, folder)  # for its refusals
    rows = [f"{i} PINHOLE {_joined(key)}\n" for key, i in ids.items()]
    point_rows = _point_lines(folder, points, colours)
    _write(folder / "cameras.txt", "CAMERA_ID MODEL WIDTH HEIGHT FX FY CX CY", rows)
    _write(folder / "points3D.txt", "POINT3D_ID X Y Z R G B ERROR TRACK[]", point_rows)
    _write(folder / "images.txt", "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, POINTS2D[]", lines)


def _point_lines(folder: Path, points: ArrayLike, colours: ArrayLike) -> list[str]:
    """The lines of ``points3D.txt``: points seen by no image, without a known error."""
    xyz, rgb = np.asarray(points, np.float64), np.asarray(colours)
    if not xyz.size:
        xyz = np.zeros((0, 3))
    if not rgb.size:
        rgb = np.zeros(xyz.shape, np.uint8)
    if not (
        xyz.shape == rgb.shape == (len(xyz), 3)
        and np.isfinite(xyz).all()
        and ((rgb >= 0) & (rgb <= 255)).all()
    ):
        raise CameraFormatError(
            f"points of shape {xyz.shape} and colours of shape {rgb.shape} do not fit together",
            path=folder,
            accepted="(P, 3) finite points and (P, 3) colours of 0 to 255",
        )
    rows = zip(xyz.tolist(), rgb.astype(int).tolist(), strict=True)
    return [f"{i} {_joined(p)} {_joined(c)} -1\n" for i, (p, c) in enumerate(rows, start=1)]


def _joined(numbers: Sequence[float]) -> str:
    """Numbers with all their digits."""
    return " ".join(map(repr, numbers))


def _write(path: Path, header: str, lines: Sequence[str]) -> None:
    with atomic_write(path) as stream:
        stream.write(f"# {header}\n".encode())
        stream.writelines(line.encode() for line in lines)


def _suffix(folder: Path) -> str | None:
    """Ending of the files of the model in a folder, or None where there is none."""
    for suffix in (".bin", ".txt"):
        if all(is_file(folder / f"{part}{suffix}") for part in ("cameras", "images")):
            return suffix
    return None
