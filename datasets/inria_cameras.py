"""``cameras.json``, the list of cameras that inria's trainer leaves beside its splats.

Source: https://github.com/graphdeco-inria/gaussian-splatting, ``utils/camera_utils.py``. Each
entry has the camera's position and its camera-to-world rotation, OpenCV axes. The format has no
principal point: it is the middle of the picture.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, TypeAdapter, ValidationError

from datasets.camera_checks import (
    MAX_SIDE,
    NamedCameras,
    image_name,
    in_name_order,
    intrinsics,
    is_file,
    posed_camera,
    world_to_camera,
)
from gvr_core.atomic import atomic_write
from gvr_core.cameras import Camera
from gvr_core.errors import CameraFormatError
from gvr_core.untrusted import read_regular

CENTRE_TOLERANCE = 1e-6
"""Pixels that a principal point may lie beside the middle of the picture and still be written."""

_Side = Annotated[int, Field(ge=1, le=MAX_SIDE)]
_Three = Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)]


class _Entry(BaseModel):
    """One camera of the file; other keys are ignored."""

    model_config = ConfigDict(strict=True)

    img_name: str
    width: _Side
    height: _Side
    position: _Three
    rotation: Annotated[list[_Three], Field(min_length=3, max_length=3)]
    fx: FiniteFloat
    fy: FiniteFloat


_ENTRIES = TypeAdapter(list[_Entry])


def read_inria_cameras(path: Path | str) -> NamedCameras:
    """The cameras of a ``cameras.json``, in name order.

    Args:
        path: The file.

    Returns:
        Image names (inria writes file stems) and cameras.

    Raises:
        CameraFormatError: if the file is missing, no such list, or has an entry that lacks a
            key, a name twice, a number that is not finite or a rotation that is none.
    """
    path = Path(path)
    if not is_file(path):
        raise CameraFormatError("no such file", path=path, accepted="a cameras.json file")
    try:
        entries = _ENTRIES.validate_json(read_regular(path))
    except OSError as error:
        raise CameraFormatError(f"cannot be read: {error.strerror}", path=path) from error
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = [f"camera {x}" if i == 0 else str(x) for i, x in enumerate(first["loc"])]
        raise CameraFormatError(
            first["msg"],
            path=path,
            place=", ".join(where) or None,
            accepted="a list of cameras with img_name, width, height, position, rotation, fx, fy",
        ) from error

    named = []
    for number, entry in enumerate(entries):
        place = f"camera {number}"
        size = (entry.width, entry.height)
        K = intrinsics((entry.fx, entry.fy, size[0] / 2, size[1] / 2), size, path, place)
        rotation = np.array(entry.rotation).T
        with np.errstate(all="ignore"):  # a product that overflows is refused just below
            pose = world_to_camera(rotation, -rotation @ np.array(entry.position))
        camera = posed_camera(K, pose, size, path, place)
        named.append((image_name(entry.img_name, path, place), camera, place))
    return in_name_order(named, path)


def write_inria_cameras(path: Path | str, images: Sequence[tuple[str, Camera]]) -> None:
    """Write cameras as a ``cameras.json``, in the order given.

    Args:
        path: The file to make or to replace; it appears whole or not at all.
        images: Image names and cameras.

    Raises:
        CameraFormatError: if the principal point of a camera is not the middle of its picture,
            or a name cannot be used.
        OSError: if the file cannot be written.
    """
    path = Path(path)
    entries = []
    for number, (name, camera) in enumerate(images):
        middle = (camera.width / 2, camera.height / 2)
        if np.abs(camera.K[:2, 2] - middle).max() > CENTRE_TOLERANCE:
            raise CameraFormatError(
                f"the principal point of {name!r} is {tuple(camera.K[:2, 2].tolist())}",
                path=path,
                accepted=f"the middle of the picture, {middle}: this format has no other",
            )
        entries.append(
            {
                "id": number,
                "img_name": image_name(name, path, f"camera {number}"),
                "width": int(camera.width),
                "height": int(camera.height),
                "position": camera.position.tolist(),
                "rotation": camera.world_to_camera[:3, :3].T.tolist(),
                "fy": float(camera.K[1, 1]),
                "fx": float(camera.K[0, 0]),
            }
        )
    with atomic_write(path) as stream:
        stream.write(json.dumps(entries, allow_nan=False).encode())
