"""Layout files: which splats stand where, and from where they are seen (TOML)."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from datasets.making import orbit_camera
from datasets.native_records import check_distinct, check_name, validation_error
from gvr_core.cameras import Camera, unit
from gvr_core.errors import DatasetError

Positive = Annotated[FiniteFloat, Field(gt=0)]
Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Text = Annotated[str, Field(min_length=1, max_length=400)]
Unit = Annotated[float, Field(ge=0, le=1)]


class _Table(BaseModel):
    """A TOML table: what it does not know, it refuses."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class ObjectTable(_Table):
    """``[[objects]]``: one splat on the ground."""

    name: str
    file: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-][A-Za-z0-9_.-]*\.(ply|splat)$")]
    """File in the folder of splats."""
    up: Vector
    """The direction, in the file's frame, that shall point up."""
    front: Vector
    """The direction, in the file's frame, that shall point to the front (-y) at yaw 0."""
    yaw: FiniteFloat = 0.0
    """Turn about the vertical, degrees, seen from above: 90 turns the front to the right (+x)."""
    position: tuple[FiniteFloat, FiniteFloat]
    """x, y of its middle on the ground, scene units."""
    height: Positive
    """Height in the scene, scene units: from the lowest to the highest 1 % of the Gaussians."""
    lift: FiniteFloat = 0.0
    """Raised by this, scene units: a splat with its own flat base would mix with the ground."""
    keep_within: tuple[Vector, Vector] | None = None
    """Lower and upper corner, in the file's frame; Gaussians with a centre outside are left out."""
    queries: Annotated[tuple[Text, ...], Field(min_length=2)]
    """Wordings that mean it."""

    def upright(self) -> NDArray[np.float64]:
        """(3, 3) rotation from the file's frame to the world's: z up, the front where yaw says."""
        z = unit(self.up)
        y = -np.asarray(self.front, np.float64)
        y = unit(y - z * (y @ z))
        turn = np.radians(self.yaw)
        about_z = np.array(
            [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
        )
        rotation: NDArray[np.float64] = about_z @ np.stack([np.cross(y, z), y, z])
        return rotation


class GroundTable(_Table):
    """``[ground]``: a textured rectangle at z = 0, its middle at the origin."""

    texture: Literal["brick", "grass", "gravel", "wood"]
    tint: tuple[Unit, Unit, Unit]
    """Mean colour."""
    contrast: Annotated[float, Field(ge=0, le=2)] = 1.0
    """Factor on the texture's own variation."""
    repeat: Annotated[int, Field(ge=1, le=16)] = 1
    """How often the texture is laid side by side, each way."""
    size: tuple[Positive, Positive]
    """Extent in x and y, scene units."""
    pitch: Positive
    """Distance between neighbouring Gaussians, scene units."""


class OrbitTable(_Table):
    """``[[cameras.knowledge]]`` and ``[[cameras.test]]``: cameras on an arc around the target."""

    count: Annotated[int, Field(ge=1, le=1000)]
    radius: Positive
    """Distance from the target, scene units."""
    yaw: tuple[FiniteFloat, FiniteFloat]
    """From, and up to but without, degrees; 0 is in front (-y), 90 to the right (+x)."""
    pitch: tuple[FiniteFloat, FiniteFloat]
    """Lowest and highest angle above the ground, degrees."""

    def poses(self) -> list[tuple[float, float]]:
        """Yaw and pitch of each camera, degrees: yaw in even steps, pitch spread over its range."""
        yaws = np.linspace(*self.yaw, self.count, endpoint=False)
        # the golden ratio's multiples fill the range evenly for any count
        low, high = self.pitch
        pitches = low + (high - low) * ((np.arange(self.count) + 0.5) * 0.6180339887 % 1)
        return list(zip(yaws.tolist(), pitches.tolist(), strict=True))


class CamerasTable(_Table):
    """``[cameras]``."""

    resolution: tuple[Annotated[int, Field(ge=16, le=8192)], Annotated[int, Field(ge=16, le=8192)]]
    """Width and height, pixels."""
    fov: Annotated[float, Field(gt=1, lt=170)]
    """Horizontal field of view, degrees."""
    target: Vector
    """What all cameras look at, scene units."""
    knowledge: Annotated[tuple[OrbitTable, ...], Field(min_length=1)]
    test: Annotated[tuple[OrbitTable, ...], Field(min_length=1)]

    def cameras(self) -> dict[str, Camera]:
        """All cameras by view name: ``view_000``... and ``test_0``..."""
        found = {}
        for kind, digits, orbits in (("view", 3, self.knowledge), ("test", 1, self.test)):
            poses = [(orbit.radius, *pose) for orbit in orbits for pose in orbit.poses()]
            for i, (radius, yaw, pitch) in enumerate(poses):
                found[f"{kind}_{i:0{digits}d}"] = orbit_camera(
                    self.target, radius, yaw, pitch, self.resolution, self.fov
                )
        return found


class AbsentTable(_Table):
    """``[[absent]]``: a query for something that is not there."""

    text: Text


class Layout(_Table):
    """A whole layout file."""

    objects: Annotated[tuple[ObjectTable, ...], Field(min_length=1)]
    ground: GroundTable
    cameras: CamerasTable
    absent: tuple[AbsentTable, ...] = ()
    licence: Text
    """Whose splats they are, and how they may be used."""


def read_layout(path: Path) -> Layout:
    """A layout file, checked.

    Raises:
        DatasetError: naming the line that is no TOML, or the key that is unknown or wrong.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DatasetError(f"not TOML: {error}", path=path) from error
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror}", path=path) from error
    try:
        layout = Layout.model_validate(content)
    except ValidationError as error:
        raise validation_error(error, path) from error
    for index, item in enumerate(layout.objects):
        check_name(item.name, "object", path, f"objects[{index}].name")
        place = f"objects[{index}].front"
        if np.linalg.norm(np.cross(item.up, item.front)) < 1e-6:
            raise DatasetError(
                f"up {item.up} and front {item.front}",
                path=path,
                place=place,
                accepted="two directions that differ",
            )
    check_distinct([item.name for item in layout.objects], "object", path, "objects")
    return layout
