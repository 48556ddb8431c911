"""Checks that every reader of camera files makes: names, poses, intrinsics."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gvr_core.cameras import Camera
from gvr_core.errors import CameraFormatError

NamedCameras = list[tuple[str, Camera]]
"""Cameras with the names of their images, in name order."""

MAX_SIDE = 65_535
"""Pixels. A longer side is damage or an attack: JPEG ends here, and renders would fill memory."""

MAX_NAME = 1024
"""Characters of an image's name: no file system has longer paths in use."""

UNDISTORT = "undistort the pictures first, for example with 'colmap image_undistorter'"
"""What to do about cameras with distortion, for messages."""


class DistortedCameraError(CameraFormatError):
    """A camera with lens distortion, which no splat is trained or rendered with."""


def image_name(text: str, path: Path, place: str) -> str:
    """An image's name as a relative POSIX path that cannot leave the images' folder.

    Args:
        text: The name as the file has it.
        path: The file, for the message.
        place: Where in the file, for the message.

    Raises:
        CameraFormatError: for an absolute name, one with ``..`` or a backslash, one with control
            characters, or none at all.
    """
    name = PurePosixPath(text)
    windows = PureWindowsPath(text)
    if (
        not name.parts
        or name.is_absolute()
        or ".." in name.parts
        or "\\" in text
        or windows.drive
        or not text.isprintable()
        or text != text.strip()
        or len(text) > MAX_NAME
    ):
        raise CameraFormatError(
            f"the image name {text[:200]!r} cannot be used",
            path=path,
            place=place,
            accepted="a relative path with forward slashes, without '..', of up to"
            f" {MAX_NAME} printable characters",
        )
    return name.as_posix()


def is_file(path: Path) -> bool:
    """Whether there is a regular file; False, too, for a path that nobody may look up."""
    with suppress(OSError):
        return path.is_file()
    return False


def is_folder(path: Path) -> bool:
    """Whether there is a folder; False, too, for a path that nobody may look up."""
    with suppress(OSError):
        return path.is_dir()
    return False


def world_to_camera(rotation: ArrayLike, translation: ArrayLike) -> NDArray[np.float64]:
    """A rigid transform (4, 4) from a rotation (3, 3) and a translation (3,)."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation
    return matrix


def rotation_matrix(quaternion: Sequence[float], path: Path, place: str) -> NDArray[np.float64]:
    """The rotation (3, 3) of a quaternion (4,) wxyz of any length above zero.

    Raises:
        CameraFormatError: if it is not finite, or its length is zero.
    """
    with np.errstate(over="ignore", under="ignore"):
        length = float(np.linalg.norm(quaternion))
    if not np.isfinite(length) or length < 1e-12:
        raise CameraFormatError(
            f"the rotation {tuple(quaternion)} has length {length}",
            path=path,
            place=place,
            accepted="a quaternion qw qx qy qz of positive length",
        )
    w, x, y, z = np.asarray(quaternion, np.float64) / length
    matrix: NDArray[np.float64] = Rotation.from_quat([x, y, z, w]).as_matrix()
    return matrix


def intrinsics(
    parameters: Sequence[float], size: tuple[int, int], path: Path, place: str
) -> NDArray[np.float64]:
    """K (3, 3) of a pinhole camera.

    Args:
        parameters: fx, fy, cx, cy in pixels.
        size: Width and height in pixels.
        path: The file, for the message.
        place: Where in the file, for the message.

    Raises:
        CameraFormatError: for a number that is not finite, a focal length that is not positive,
            or a size that no picture has.
    """
    fx, fy, cx, cy = parameters
    if not np.isfinite(parameters).all() or fx <= 0 or fy <= 0:
        raise CameraFormatError(
            f"intrinsics fx {fx}, fy {fy}, cx {cx}, cy {cy}",
            path=path,
            place=place,
            accepted="finite numbers, with positive focal lengths",
        )
    if not (1 <= size[0] <= MAX_SIDE and 1 <= size[1] <= MAX_SIDE):
        raise CameraFormatError(
            f"picture size {size[0]} x {size[1]}",
            path=path,
            place=place,
            accepted=f"1 to {MAX_SIDE} pixels a side",
        )
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=np.float64)


def posed_camera(
    K: NDArray[np.float64],
    pose: NDArray[np.float64],
    size: tuple[int, int],
    path: Path,
    place: str,
) -> Camera:
    """A camera, with the place in the file added to whatever is wrong with it.

    Args:
        K: (3, 3) intrinsics in pixels.
        pose: (4, 4) world to camera, OpenCV axes.
        size: Width and height in pixels.
        path: The file, for the message.
        place: Where in the file, for the message.

    Raises:
        CameraFormatError: as :class:`~gvr_core.cameras.Camera` raises it.
    """
    try:
        # Rotations with entries near the end of the number range overflow before they are refused.
        with np.errstate(all="ignore"):
            return Camera(K, pose, *size)
    except CameraFormatError as error:
        raise CameraFormatError(
            error.message,
            path=path,
            place=place,
            accepted=error.accepted or "finite numbers",
        ) from error


def in_name_order(named: Iterable[tuple[str, Camera, str]], path: Path) -> NamedCameras:
    """Cameras sorted by name.

    Args:
        named: Name, camera and place in the file of each.
        path: The file, for the message.

    Raises:
        CameraFormatError: if two have one name, or there is none.
    """
    cameras: dict[str, Camera] = {}
    for name, camera, place in named:
        if name in cameras:
            raise CameraFormatError(
                f"the image {name!r} is there twice",
                path=path,
                place=place,
                accepted="images with different names",
            )
        cameras[name] = camera
    if not cameras:
        raise CameraFormatError("no image", path=path, accepted="one posed image or more")
    return sorted(cameras.items())
