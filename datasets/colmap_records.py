"""What the text and the binary form of a COLMAP model have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.camera_checks import image_name, intrinsics, rotation_matrix, world_to_camera
from gvr_core.errors import CameraFormatError

CAMERA_MODELS = (
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE",
    "SIMPLE_DIVISION",
    "DIVISION",
    "SIMPLE_FISHEYE",
    "FISHEYE",
    "EUCM",
    "EQUIRECTANGULAR",
)
"""COLMAP's camera models; the binary form stores the index (``colmap/sensor/models.h``)."""

PARAMETERS = {"SIMPLE_PINHOLE": ("f", "cx", "cy"), "PINHOLE": ("fx", "fy", "cx", "cy")}
"""The models that are read, and their parameters in pixels."""

_ACCEPTED = (
    f"{' or '.join(PARAMETERS)}; undistort the images first, for example with"
    " 'colmap image_undistorter'"
)


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """One camera of a model, shared by the images taken with it."""

    K: NDArray[np.float64]
    """(3, 3) in pixels. COLMAP, too, has the centre of the first pixel at (0.5, 0.5)."""
    size: tuple[int, int]
    """Width and height in pixels."""


@dataclass(frozen=True, eq=False)
class Pose:
    """One image of a model."""

    name: str
    """Relative POSIX path."""
    world_to_camera: NDArray[np.float64]
    """(4, 4), OpenCV axes."""
    camera: int
    """Id of its camera."""
    place: str
    """Where in the file it stands."""


def parameter_count(model: str, path: Path, place: str) -> int:
    """Number of parameters of a camera model.

    Raises:
        CameraFormatError: for a model with distortion.
    """
    if model not in PARAMETERS:
        raise CameraFormatError(
            f"the camera model is {model[:40]}", path=path, place=place, accepted=_ACCEPTED
        )
    return len(PARAMETERS[model])


def intrinsics_of(
    model: str, size: tuple[int, int], parameters: Sequence[float], path: Path, place: str
) -> Intrinsics:
    """A camera from its model and parameters.

    Args:
        model: Name of the camera model.
        size: Width and height in pixels.
        parameters: As the model orders them.
        path: The file, for the message.
        place: Where in the file, for the message.

    Raises:
        CameraFormatError: for a model with distortion, too many or too few parameters, or
            numbers that no camera has.
    """
    if len(parameters) != parameter_count(model, path, place):
        raise CameraFormatError(
            f"the camera has {len(parameters)} parameters",
            path=path,
            place=place,
            accepted=f"{' '.join(PARAMETERS[model])} for {model}",
        )
    if model == "SIMPLE_PINHOLE":
        parameters = [parameters[0], *parameters]
    return Intrinsics(intrinsics(parameters, size, path, place), size)


def pose_of(
    quaternion: Sequence[float],
    translation: Sequence[float],
    camera: int,
    name: str,
    path: Path,
    place: str,
) -> Pose:
    """An image from its rotation (4,) wxyz and translation (3,), both world to camera.

    Raises:
        CameraFormatError: for a number that is not finite, a rotation of length zero, or a name
            that cannot be used.
    """
    if not np.isfinite(translation).all():
        raise CameraFormatError(
            f"the translation is {tuple(translation)}",
            path=path,
            place=place,
            accepted="finite numbers",
        )
    matrix = world_to_camera(rotation_matrix(quaternion, path, place), translation)
    return Pose(image_name(name, path, place), matrix, camera, place)
