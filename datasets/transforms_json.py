"""``transforms.json``: the cameras of nerfstudio and instant-ngp.

Sources: ``nerfstudio/process_data/colmap_utils.py`` and
``nerfstudio/data/dataparsers/nerfstudio_dataparser.py`` (nerfstudio-project/nerfstudio),
``scripts/colmap2nerf.py`` (NVlabs/instant-ngp).

Each frame has a camera-to-world matrix with OpenGL axes in the camera frame (x right, y up, z
backward); here they become world-to-camera with OpenCV axes. The world frame that comes out:

* nerfstudio's tools swap the axes of COLMAP's world and say so (``applied_transform``, a rigid
  3 x 4 matrix A, and ``applied_scale``, s: a point p of the capture becomes s A p). Both are
  undone, so that cameras are in COLMAP's world, as a splat trained on COLMAP's model is.
* instant-ngp's script turns, centres and scales the world and does not say how: cameras are in
  the world of the file. (Run with ``--keep_colmap_coords`` it keeps COLMAP's.) ``scale``,
  ``offset``, ``aabb_scale``, ``orientation_override`` and their like tell a trainer what to do on
  loading; they do not change what the matrices mean, and are passed over.

Intrinsics are in pixels (``fl_x``, ``fl_y``, ``cx``, ``cy``, ``w``, ``h``), for the whole file or
for a frame, the latter going first. ``camera_angle_x`` and ``camera_angle_y`` (radians) stand in
for focal lengths, one focal length for the other, the middle of the picture for the principal
point, and the picture's own size for ``w`` and ``h``.
"""

from __future__ import annotations

import math
from pathlib import Path, PurePosixPath
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from datasets.camera_checks import (
    UNDISTORT,
    DistortedCameraError,
    NamedCameras,
    image_name,
    in_name_order,
    intrinsics,
    is_file,
    posed_camera,
    world_to_camera,
)
from datasets.picture_folder import PictureFolder, picture_size
from gvr_core.errors import CameraFormatError
from gvr_core.untrusted import read_regular

PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "PERSPECTIVE")
"""Values of ``camera_model`` that are a pinhole where all coefficients are zero."""

COEFFICIENTS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
"""Keys of the distortion."""

RIGID_TOLERANCE = 1e-4
"""How far a rotation's product with its transpose may be from the identity."""

_BOM = b"\xef\xbb\xbf"
_Angle = Annotated[float, Field(gt=0, lt=math.pi, allow_inf_nan=False)]
_Row = Annotated[list[FiniteFloat], Field(min_length=4, max_length=4)]
_Matrix = Annotated[list[_Row], Field(min_length=3, max_length=4)]


class _Lens(BaseModel):
    """What the file says for all frames, and each frame for itself; other keys are ignored."""

    model_config = ConfigDict(strict=True)

    fl_x: FiniteFloat | None = None
    fl_y: FiniteFloat | None = None
    cx: FiniteFloat | None = None
    cy: FiniteFloat | None = None
    w: FiniteFloat | None = None
    h: FiniteFloat | None = None
    camera_angle_x: _Angle | None = None
    camera_angle_y: _Angle | None = None
    k1: FiniteFloat | None = None
    k2: FiniteFloat | None = None
    k3: FiniteFloat | None = None
    k4: FiniteFloat | None = None
    k5: FiniteFloat | None = None
    k6: FiniteFloat | None = None
    p1: FiniteFloat | None = None
    p2: FiniteFloat | None = None
    distortion_params: list[FiniteFloat] | None = None
    is_fisheye: bool | None = None
    camera_model: str | None = None


class _Frame(_Lens):
    """One posed picture."""

    file_path: str
    transform_matrix: _Matrix


class _File(_Lens):
    """The whole file."""

    frames: list[_Frame]
    applied_transform: _Matrix | None = None
    applied_scale: FiniteFloat | None = None


def is_transforms_json(path: Path) -> bool:
    """Whether a JSON file is a ``transforms.json`` (an object) and not a list of cameras."""
    try:
        with path.open("rb") as stream:
            return stream.read(4096).removeprefix(_BOM).lstrip()[:1] == b"{"
    except OSError:
        return False


def read_transforms_json(path: Path | str) -> NamedCameras:
    """The cameras of a ``transforms.json``, in name order.

    Args:
        path: The file. Pictures are found from its folder, and opened only where the file does
            not say their size.

    Returns:
        Image names, as the file has them without a leading ``./``, and cameras.

    Raises:
        DistortedCameraError: for a distortion that is not zero, or a fisheye camera.
        CameraFormatError: if the file is missing or not such a file, a frame lacks a focal length
            or a size, or has a name twice, a number that is not finite, or a matrix that is not
            rigid.
        DatasetError: for a picture that is needed for its size, and is missing or damaged.
    """
    path = Path(path)
    if not is_file(path):
        raise CameraFormatError("no such file", path=path, accepted="a transforms.json file")
    content = _parsed(path)
    undo = _undoing(content, path)
    named = []
    pictures = PictureFolder.of(path.parent)
    for number, frame in enumerate(content.frames):
        place = f"frame {number}"
        name = image_name(str(PurePosixPath(frame.file_path)), path, place)
        _check_undistorted((frame, content), path, place)
        size = _size(frame, content, name, pictures, path, place)
        K = intrinsics(_focal_and_centre(frame, content, size, path, place), size, path, place)
        pose = _world_to_camera(frame, undo, content.applied_scale or 1.0, path, place)
        named.append((name, posed_camera(K, pose, size, path, place), place))
    return in_name_order(named, path)


def _parsed(path: Path) -> _File:
    """The content of the file, its keys and types checked."""
    try:
        return _File.model_validate_json(read_regular(path).removeprefix(_BOM))
    except OSError as error:
        raise CameraFormatError(f"cannot be read: {error.strerror}", path=path) from error
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        keys = [str(key) for key in first["loc"]]
        if keys[:1] == ["frames"] and keys[1:]:
            keys = [f"frame {keys[1]}", *keys[2:]]
        raise CameraFormatError(
            first["msg"],
            path=path,
            place=", ".join(keys) or None,
            accepted="an object with frames, each with file_path and transform_matrix (4 x 4)",
        ) from error


def _undoing(content: _File, path: Path) -> NDArray[np.float64]:
    """The rigid transform (4, 4) that was applied to the capture's world; identity where none."""
    if content.applied_scale is not None and content.applied_scale <= 0:
        raise CameraFormatError(
            f"applied_scale is {content.applied_scale}", path=path, accepted="a positive number"
        )
    if content.applied_transform is None:
        return np.eye(4)
    return _rigid(content.applied_transform, path, "applied_transform")


def _world_to_camera(
    frame: _Frame, undo: NDArray[np.float64], scale: float, path: Path, place: str
) -> NDArray[np.float64]:
    """The pose (4, 4) of a frame in the capture's world, OpenCV axes."""
    stored = _rigid(frame.transform_matrix, path, place)
    turned = undo[:3, :3].T
    with np.errstate(all="ignore"):  # a product that overflows is refused with its camera
        position = turned @ (stored[:3, 3] / scale - undo[:3, 3])
        rotation = (turned @ stored[:3, :3] @ np.diag([1.0, -1.0, -1.0])).T
        return world_to_camera(rotation, -rotation @ position)


def _rigid(rows: list[list[float]], path: Path, place: str) -> NDArray[np.float64]:
    """A matrix (4, 4) from the three or four rows of a rigid transform."""
    matrix = np.eye(4)
    matrix[: len(rows)] = rows
    rotation = matrix[:3, :3]
    with np.errstate(all="ignore"):
        squared = rotation @ rotation.T
        stretched = not np.allclose(squared, np.eye(3), rtol=0, atol=RIGID_TOLERANCE)
        mirrored = not np.linalg.det(rotation) > 0
    if stretched or mirrored or matrix[3].tolist() != [0, 0, 0, 1]:
        why = "last row is not 0 0 0 1"
        if stretched or mirrored:
            why = "columns are not orthonormal" if stretched else "determinant is not positive"
        raise CameraFormatError(
            f"the matrix is not rigid: its {why}",
            path=path,
            place=place,
            accepted="a rotation and a translation, without scale or mirroring",
        )
    return matrix


def _check_undistorted(lenses: tuple[_Lens, ...], path: Path, place: str) -> None:
    """Refuse a distortion that a frame, or the file for all frames, states."""
    for lens in lenses:
        found = [f"{key} {value}" for key in COEFFICIENTS if (value := getattr(lens, key))]
        if any(lens.distortion_params or ()):
            found.append(f"distortion_params {lens.distortion_params}")
        if lens.is_fisheye:
            found.append("is_fisheye")
        if lens.camera_model is not None and lens.camera_model not in PINHOLES:
            found.append(f"camera_model {lens.camera_model[:40]}")
        if found:
            raise DistortedCameraError(
                f"the camera has distortion: {', '.join(found)}",
                path=path,
                place=place,
                accepted=f"a pinhole camera; {UNDISTORT}",
            )


def _size(
    frame: _Lens, content: _Lens, name: str, pictures: PictureFolder, path: Path, place: str
) -> tuple[int, int]:
    """Width and height: the frame's, the file's, or the picture's own."""
    width, height = _either(frame.w, content.w), _either(frame.h, content.h)
    if width is None or height is None:
        picture = pictures.elsewhere(name)
        if picture is None:
            raise CameraFormatError(
                f"no w and h, and no picture {name!r} to take them from",
                path=path,
                place=place,
                accepted="w and h in pixels, or a picture that is there",
            )
        return picture_size(picture)
    if not (width.is_integer() and height.is_integer()):
        raise CameraFormatError(
            f"picture size {width} x {height}", path=path, place=place, accepted="whole pixels"
        )
    return int(width), int(height)


def _focal_and_centre(
    frame: _Lens, content: _Lens, size: tuple[int, int], path: Path, place: str
) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy in pixels."""
    fx = _either(
        _focal(frame.fl_x, frame.camera_angle_x, size[0]),
        _focal(content.fl_x, content.camera_angle_x, size[0]),
    )
    fy = _either(
        _focal(frame.fl_y, frame.camera_angle_y, size[1]),
        _focal(content.fl_y, content.camera_angle_y, size[1]),
    )
    # Square pixels where the file knows one focal length: the custom of both programs.
    fx, fy = _either(fx, fy), _either(fy, fx)
    if fx is None or fy is None:
        raise CameraFormatError(
            "no focal length",
            path=path,
            place=place,
            accepted="fl_x and fl_y in pixels, or camera_angle_x in radians, for all frames or"
            " for this one",
        )
    cx, cy = _either(frame.cx, content.cx), _either(frame.cy, content.cy)
    return fx, fy, size[0] / 2 if cx is None else cx, size[1] / 2 if cy is None else cy


def _focal(stated: float | None, angle: float | None, side: int) -> float | None:
    """A focal length in pixels: as stated, or from the angle of view (radians) over a side."""
    if stated is not None or angle is None:
        return stated
    return 0.5 * side / math.tan(angle / 2)


def _either(first: float | None, second: float | None) -> float | None:
    return second if first is None else first
