"""The binary form of COLMAP models (https://colmap.github.io/format.html), little-endian.

Every count is compared with what is left of the file before anything is made for it.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from datasets.colmap_records import (
    CAMERA_MODELS,
    Intrinsics,
    Pose,
    intrinsics_of,
    parameter_count,
    pose_of,
)
from gvr_core.errors import CameraFormatError

MAX_NAME_BYTES = 4096
"""Length of an image's name beyond which the file is taken for damaged."""

_COUNT = struct.Struct("<Q")
_CAMERA = struct.Struct("<IiQQ")  # id, model, width, height
_IMAGE = struct.Struct("<I4d3dI")  # id, rotation wxyz, translation, camera id
_POINT = struct.Struct("<Q3d3BdQ")  # id, position, colour, error, length of the track
_POINT_2D_BYTES = 24
_TRACK_ENTRY_BYTES = 8


class _Records:
    """A file of records, read in order and never beyond its end."""

    def __init__(self, stream: BinaryIO, path: Path) -> None:
        self.path = path
        self._stream = stream
        self._left = os.fstat(stream.fileno()).st_size

    def take(self, layout: struct.Struct, place: str) -> tuple[Any, ...]:
        """The next fields of a record."""
        return layout.unpack(self.take_bytes(layout.size, place))

    def take_bytes(self, size: int, place: str) -> bytes:
        """The next bytes."""
        content = self._stream.read(min(size, self._left))
        self._left -= len(content)
        if len(content) < size:
            raise CameraFormatError(
                "the file ends early", path=self.path, place=place, accepted="a whole file"
            )
        return content

    def take_name(self, place: str) -> str:
        """The next text, which ends with a zero byte."""
        content = bytearray()
        while (byte := self.take_bytes(1, place)) != b"\0":
            content += byte
            if len(content) > MAX_NAME_BYTES:
                raise CameraFormatError(
                    "an image's name has no end",
                    path=self.path,
                    place=place,
                    accepted=f"up to {MAX_NAME_BYTES} bytes and a zero",
                )
        try:
            return content.decode("utf-8")
        except UnicodeDecodeError as error:
            raise CameraFormatError(
                f"the image name {bytes(content[:40])!r} is no text",
                path=self.path,
                place=place,
                accepted="UTF-8",
            ) from error

    def skip(self, size: int) -> None:
        """Pass over bytes that a count was already checked for."""
        self._stream.seek(size, os.SEEK_CUR)
        self._left -= size

    def take_count(self, least: int, what: str, place: str) -> int:
        """The next count, if the file can hold that many records of so many bytes."""
        (count,) = self.take(_COUNT, place)
        return self.checked_count(count, least, what, place)

    def checked_count(self, count: int, least: int, what: str, place: str) -> int:
        """A count, if the file can hold that many records of so many bytes."""
        if count * least > self._left:
            raise CameraFormatError(
                f"the file promises {count} {what}, which is {count * least} bytes or more, but"
                f" holds only {self._left} more",
                path=self.path,
                place=place,
                accepted="a whole file whose counts tell the truth",
            )
        return count

    def finish(self) -> None:
        """Refuse what stands after the last record: the count before it cannot be right."""
        if self._left:
            raise CameraFormatError(
                f"{self._left} bytes follow the last record",
                path=self.path,
                place="end of file",
                accepted="as many records as the file says",
            )


@contextmanager
def _records(path: Path) -> Iterator[_Records]:
    try:
        with path.open("rb") as stream:
            records = _Records(stream, path)
            yield records
            records.finish()
    except OSError as error:
        raise CameraFormatError(f"cannot be read: {error.strerror}", path=path) from error


def read_cameras_binary(path: Path) -> dict[int, Intrinsics]:
    """Intrinsics by camera id, from ``cameras.bin``.

    Raises:
        CameraFormatError: naming the record that is not as the format says.
    """
    cameras: dict[int, Intrinsics] = {}
    with _records(path) as records:
        for index in range(records.take_count(_CAMERA.size, "cameras", "start of file")):
            place = f"record {index}"
            number, model_id, width, height = records.take(_CAMERA, place)
            known = 0 <= model_id < len(CAMERA_MODELS)
            model = CAMERA_MODELS[model_id] if known else f"number {model_id}"
            layout = struct.Struct(f"<{parameter_count(model, path, place)}d")
            parameters = records.take(layout, place)
            if number in cameras:
                raise CameraFormatError(
                    f"camera {number} is there twice",
                    path=path,
                    place=place,
                    accepted="each id once",
                )
            cameras[number] = intrinsics_of(model, (width, height), parameters, path, place)
    return cameras


def read_images_binary(path: Path) -> list[Pose]:
    """Poses in the order of ``images.bin``; the images' points are passed over.

    Raises:
        CameraFormatError: naming the record that is not as the format says.
    """
    poses = []
    with _records(path) as records:
        least = _IMAGE.size + 1 + _COUNT.size
        for index in range(records.take_count(least, "images", "start of file")):
            place = f"record {index}"
            _, *numbers, camera = records.take(_IMAGE, place)
            name = records.take_name(place)
            poses.append(pose_of(numbers[:4], numbers[4:], camera, name, path, place))
            count = records.take_count(_POINT_2D_BYTES, "points in an image", place)
            records.skip(count * _POINT_2D_BYTES)
    return poses


def read_points_binary(path: Path) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Points (P, 3) in the world frame and their colours (P, 3), from ``points3D.bin``.

    Raises:
        CameraFormatError: naming the record that is not as the format says.
    """
    with _records(path) as records:
        count = records.take_count(_POINT.size, "points", "start of file")
        points = np.empty((count, 3), np.float64)
        colours = np.empty((count, 3), np.uint8)
        for index in range(count):
            place = f"record {index}"
            _, x, y, z, red, green, blue, _, track = records.take(_POINT, place)
            points[index] = x, y, z
            colours[index] = red, green, blue
            records.checked_count(track, _TRACK_ENTRY_BYTES, "images of a point", place)
            records.skip(track * _TRACK_ENTRY_BYTES)
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        index = int(np.argmin(finite))
        raise CameraFormatError(
            f"the point is {points[index].tolist()}",
            path=path,
            place=f"record {index}",
            accepted="finite numbers",
        )
    return points, colours
