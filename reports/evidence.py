"""The evidence for a method's answers on a scene: what it looked at, step by step, in small.

One file for each (scene, method), ``evidence/<...>.json`` in the result's folder, made when the
answers are scored and written with them, so that a report needs the result's folder alone. Pictures
are WebP in base64; outlines are SVG paths in the pixels of the picture that they lie on.
"""

from __future__ import annotations

import base64
import io
import re
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gvr_core.atomic import file_digest
from reports.result_check import ResultError

EVIDENCE_VERSION = 1
"""Version of the records in this file."""

THUMBNAIL_WIDTH = 240
"""Widest picture of a step, pixels."""
FINAL_WIDTH = 360
"""Widest picture of an answer, pixels."""
QUALITY = 68
"""Of WebP, 0 to 100."""
TOLERANCE = 0.6
"""How far an outline may run beside the mask's own, pixels of the thumbnail."""

Array = NDArray[Any]


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Picture(_Record):
    """A small picture, and what is outlined on it."""

    width: int = Field(ge=1)
    height: int = Field(ge=1)
    webp: str = Field(pattern=r"^[A-Za-z0-9+/]+={0,2}$")
    """WebP, base64."""
    outline: str | None = Field(default=None, pattern=r"^[MLZ0-9 .-]*$")
    """SVG path of what a model or the truth marks here; None where it marks nothing."""


class Cloud(_Record):
    """Some of the scene's Gaussians, to see the votes among: 16 bits a coordinate."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    points: str
    """(n, 3) uint16 little-endian, base64: 0 stands for ``low`` and 65535 for ``high``."""
    colours: str
    """(n, 3) uint8, base64."""


class Camera(_Record):
    """Where a knowledge view was taken from."""

    name: str
    position: tuple[float, float, float]
    picture: Picture | None = None
    """None where no query's patch was retrieved from it."""


class Vote(_Record):
    """The patch that one view puts forward, and where it lies in 3D."""

    view: int = Field(ge=0)
    """Index into the cameras."""
    score: float
    """Relevancy of the patch."""
    point: tuple[float, float, float]
    """L_3D of this view, world frame."""
    place: int = Field(ge=-1)
    """Index of the place that it supports; -1 for none."""
    outline: str = Field(pattern=r"^[MLZ0-9 .-]*$")
    """SVG path of the patch, on the view's picture."""
    pixel: tuple[float, float]
    """L_2D, on the view's picture."""


class AgreedPlace(_Record):
    """A place at which views agree."""

    location: tuple[float, float, float]
    radius: float
    weight: float


class VirtualPicture(Picture):
    """A virtual camera's picture, and the mask that a model cut from it."""

    role: Literal["bev", "ring"]


class FinalPicture(Picture):
    """The answer dyed red in a view, and the truth's outline."""

    view: str
    test: bool
    """Whether it is a test view; else there are none, or none shows the object."""


class QueryEvidence(_Record):
    """The steps of one query."""

    query: str
    votes: tuple[Vote, ...] = ()
    places: tuple[AgreedPlace, ...] = ()
    virtual: tuple[VirtualPicture, ...] = ()
    finals: tuple[FinalPicture, ...] = ()
    n_more_finals: int = 0
    """Test views in which the object is labelled, and which are not drawn here."""


class SceneEvidence(_Record):
    """The evidence of one method on one scene."""

    version: int = EVIDENCE_VERSION
    up: tuple[float, float, float]
    cloud: Cloud
    cameras: tuple[Camera, ...]
    queries: tuple[QueryEvidence, ...]


def thumbnail_size(width: int, height: int, widest: int = THUMBNAIL_WIDTH) -> tuple[int, int]:
    """Width and height of a picture's thumbnail; pictures are never enlarged."""
    scale = min(1.0, widest / width)
    return max(1, round(width * scale)), max(1, round(height * scale))


def to_webp(rgb: Array, widest: int = THUMBNAIL_WIDTH) -> bytes:
    """A picture in small.

    Args:
        rgb: (H, W, 3), floats in [0, 1] or uint8.
        widest: Width beyond which it is made smaller, pixels.
    """
    pixels = rgb
    if rgb.dtype != np.uint8:
        pixels = np.rint(np.clip(rgb, 0, 1) * np.float32(255)).astype(np.uint8)
    size = thumbnail_size(pixels.shape[1], pixels.shape[0], widest)
    image = Image.fromarray(np.ascontiguousarray(pixels))
    if size != image.size:
        # Halves and quarters first: a tenth of the time, and nothing that the eye would see.
        image = image.resize(size, Image.Resampling.BILINEAR, reducing_gap=2.0)
    file = io.BytesIO()
    image.save(file, "WEBP", quality=QUALITY, method=2)
    return file.getvalue()


def picture_fields(webp: bytes, size: tuple[int, int]) -> dict[str, Any]:
    """A WebP as the fields of a :class:`Picture`.

    Args:
        webp: The picture.
        size: Its width and height, pixels.
    """
    return {"width": size[0], "height": size[1], "webp": base64.b64encode(webp).decode()}


def outline_path(mask: NDArray[np.bool_], size: tuple[int, int]) -> str:
    """The outline of a mask as an SVG path, holes included.

    Args:
        mask: (H, W).
        size: Width and height of the picture that it will lie on, pixels.

    Returns:
        ``M..L..Z`` for each part; empty where the mask is.
    """
    height, width = mask.shape
    scale = np.array([size[0] / width, size[1] / height])
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    parts = []
    for contour in contours:
        corners = cv2.approxPolyDP(contour, TOLERANCE / float(scale.min()), closed=True)[:, 0]
        points = np.round((corners + 0.5) * scale, 1)
        parts.append("M" + "L".join(f"{x:g} {y:g}" for x, y in points) + "Z")
    return "".join(parts)


def cloud_of(means: Array, colours: Array) -> Cloud:
    """Points of a scene for the picture of the votes.

    Args:
        means: (n, 3), world frame.
        colours: (n, 3) uint8.
    """
    low, high = means.min(axis=0).astype(np.float64), means.max(axis=0).astype(np.float64)
    span = np.maximum(high - low, 1e-12)
    steps = np.rint((means - low) / span * 65535).astype("<u2")
    return Cloud(
        low=triple(low),
        high=triple(high),
        points=base64.b64encode(steps.tobytes()).decode(),
        colours=base64.b64encode(colours.astype(np.uint8).tobytes()).decode(),
    )


def triple(vector: Array) -> tuple[float, float, float]:
    """(3,) as plain numbers, to six digits: a report shows no more."""
    x, y, z = (float(f"{value:.6g}") for value in vector)
    return x, y, z


def read_evidence(folder: Path, name: str, sums: dict[str, str]) -> SceneEvidence:
    """Read one file of evidence of a result.

    Args:
        folder: The result's folder.
        name: Its path in there.
        sums: Path -> sha256, as the result has it.

    Raises:
        ResultError: for a file that is missing, was changed after it was written, or is of another
            version.
    """
    path = folder / name
    if not re.fullmatch(r"evidence(/[A-Za-z0-9_-][A-Za-z0-9_.-]*)+", name):
        raise ResultError(f"evidence named {name!r}", path=folder, accepted="evidence/<name>")
    try:
        content = path.read_bytes()
        found = file_digest(path)
    except OSError as error:
        raise ResultError(f"cannot be read: {error.strerror}", path=path) from error
    if sums.get(name) != found:
        raise ResultError(
            f"the file's sha256 is {found}; it was changed after it was written",
            path=path,
            accepted=sums.get(name, "a file listed in SHA256SUMS"),
        )
    try:
        evidence = SceneEvidence.model_validate_json(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ResultError(first["msg"], path=path, place=place) from error
    if evidence.version != EVIDENCE_VERSION:
        raise ResultError(
            f"evidence of version {evidence.version}",
            path=path,
            place="version",
            accepted=str(EVIDENCE_VERSION),
        )
    return evidence
