"""The text form of COLMAP models (https://colmap.github.io/format.html)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from datasets.colmap_records import Intrinsics, Pose, intrinsics_of, pose_of
from gvr_core.errors import CameraFormatError

Number = TypeVar("Number", int, float)


def read_cameras_text(path: Path) -> dict[int, Intrinsics]:
    """Intrinsics by camera id, from ``cameras.txt``.

    Raises:
        CameraFormatError: naming the line that is not as the format says.
    """
    cameras: dict[int, Intrinsics] = {}
    for place, line in _content_lines(path):
        words = line.split()
        if len(words) < 4:
            raise _fields(path, place, len(words), "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]")
        number, width, height = (
            _parsed(int, word, path, place) for word in (words[0], words[2], words[3])
        )
        parameters = [_parsed(float, word, path, place) for word in words[4:]]
        if number in cameras:
            raise CameraFormatError(
                f"camera {number} is there twice", path=path, place=place, accepted="each id once"
            )
        cameras[number] = intrinsics_of(words[1], (width, height), parameters, path, place)
    return cameras


def read_images_text(path: Path) -> list[Pose]:
    """Poses in the order of ``images.txt``.

    A name may hold spaces, which COLMAP writes but does not read. The second line of an image
    (its points) is not kept; the last image may lack it.

    Raises:
        CameraFormatError: naming the line that is not as the format says.
    """
    poses = []
    lines = _lines(path)
    for place, line in lines:
        if _is_comment(line):
            continue
        words = line.split(maxsplit=9)
        if len(words) < 10:
            raise _fields(path, place, len(words), "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME")
        _parsed(int, words[0], path, place)
        numbers = [_parsed(float, word, path, place) for word in words[1:8]]
        camera = _parsed(int, words[8], path, place)
        poses.append(pose_of(numbers[:4], numbers[4:], camera, words[9].rstrip(), path, place))
        # Files whose empty lines were lost would otherwise give every other image, silently.
        place, points = next(lines, (place, ""))
        if len(points.split()) % 3:
            raise _fields(path, place, len(points.split()), "(X Y POINT3D_ID) for each point")
    return poses


def read_points_text(path: Path) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Points (P, 3) in the world frame and their colours (P, 3), from ``points3D.txt``.

    Raises:
        CameraFormatError: naming the line that is not as the format says.
    """
    points, colours = [], []
    for place, line in _content_lines(path):
        words = line.split()
        if len(words) < 8 or len(words) % 2:
            raise _fields(path, place, len(words), "POINT3D_ID X Y Z R G B ERROR TRACK[]")
        point = [_parsed(float, word, path, place) for word in words[1:4]]
        colour = [_parsed(int, word, path, place) for word in words[4:7]]
        if not np.isfinite(point).all() or min(colour) < 0 or max(colour) > 255:
            raise CameraFormatError(
                f"point {point}, colour {colour}",
                path=path,
                place=place,
                accepted="finite coordinates, and colours of 0 to 255",
            )
        points.append(point)
        colours.append(colour)
    return (
        np.array(points, dtype=np.float64).reshape(-1, 3),
        np.array(colours, dtype=np.uint8).reshape(-1, 3),
    )


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    """Each line of a text file, with the words that say where it is."""
    try:
        with path.open(encoding="utf-8-sig") as stream:
            for number, line in enumerate(stream, start=1):
                yield f"line {number}", line.strip("\r\n")
    except UnicodeDecodeError as error:
        raise CameraFormatError(
            f"the file is no text: {error.reason}", path=path, accepted="UTF-8 text"
        ) from error
    except OSError as error:
        raise CameraFormatError(f"cannot be read: {error.strerror}", path=path) from error


def _content_lines(path: Path) -> Iterator[tuple[str, str]]:
    """The lines that are neither empty nor comments."""
    return ((place, line) for place, line in _lines(path) if not _is_comment(line))


def _is_comment(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith("#")


def _parsed(kind: Callable[[str], Number], word: str, path: Path, place: str) -> Number:
    """A word as a number."""
    try:
        return kind(word)
    except ValueError as error:
        wanted = "a whole number" if kind is int else "a number"
        raise CameraFormatError(
            f"{word[:40]!r} is not {wanted}", path=path, place=place, accepted=wanted
        ) from error


def _fields(path: Path, place: str, count: int, accepted: str) -> CameraFormatError:
    return CameraFormatError(
        f"the line has {count} fields", path=path, place=place, accepted=accepted
    )
