"""What the text and the binary form of a COLMAP model have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.camera_checks import (
    UNDISTORT,
    DistortedCameraError,
    image_name,
    intrinsics,
    rotation_matrix,
    world_to_camera,
)
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

_RADIAL = ("f", "cx", "cy", "k1")
_OPENCV = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
PARAMETERS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": _RADIAL,
    "RADIAL": (*_RADIAL, "k2"),
    "OPENCV": _OPENCV,
    "FULL_OPENCV": (*_OPENCV, "k3", "k4", "k5", "k6"),
}
"""The models that are read, and their parameters: focal lengths and principal point in pixels,
then the coefficients of the distortion. Where these are all zero, the camera is a pinhole. (A
fisheye camera is none even then.)"""

_ACCEPTED = (
    "SIMPLE_PINHOLE or PINHOLE, or SIMPLE_RADIAL, RADIAL, OPENCV or FULL_OPENCV with coefficients"
    f" of zero; {UNDISTORT}"
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
        DistortedCameraError: for a model that is never a pinhole.
    """
    if model not in PARAMETERS:
        raise DistortedCameraError(
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
        DistortedCameraError: for a camera with distortion.
        CameraFormatError: for too many or too few parameters, or numbers that no camera has.
    """
    if len(parameters) != parameter_count(model, path, place):
        raise CameraFormatError(
            f"the camera has {len(parameters)} parameters",
            path=path,
            place=place,
            accepted=f"{' '.join(PARAMETERS[model])} for {model}",
        )
    names = PARAMETERS[model]
    bent = {n: x for n, x in zip(names, parameters, strict=True) if n[0] in "kp" and x != 0}
    if bent:
        listed = ", ".join(f"{name} {value}" for name, value in bent.items())
        raise DistortedCameraError(
            f"the camera model is {model} with distortion: {listed}",
            path=path,
            place=place,
            accepted=_ACCEPTED,
        )
    single = names[0] == "f"
    pinhole = [parameters[0], *parameters[:3]] if single else list(parameters[:4])
    return Intrinsics(intrinsics(pinhole, size, path, place), size)


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
