"""The labelled things of a layout: splats, boxes with a photograph on them, flat areas."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    Discriminator,
    Field,
    FiniteFloat,
    Tag,
    ValidationInfo,
    field_validator,
)

from datasets.layout_tables import Direction, Point, Positive, Table, Text, TextureTable, Vector
from datasets.photographs import PHOTOGRAPHS
from gvr_core.cameras import unit


def _known_photograph(name: str) -> str:
    names = [photograph.name for photograph in PHOTOGRAPHS]
    if name not in names:
        raise ValueError(f"no photograph; accepted: {', '.join(names)}")
    return name


class CopyTable(Table):
    """``copies``: one more instance of an object, the same but for its place."""

    position: Point
    """x, y of its middle on the ground, scene units."""
    yaw: FiniteFloat = 0.0
    """Turn about the vertical, degrees, as of the object."""


class ObjectTable(Table):
    """``[[objects]]``: what all kinds of things have in common."""

    ADDED_LATER: ClassVar[tuple[str, ...]] = ("copies",)

    name: str
    yaw: FiniteFloat = 0.0
    """Turn about the vertical, degrees, seen from above: 90 turns the front to the right (+x)."""
    position: Point
    """x, y of its middle on the ground, scene units."""
    lift: FiniteFloat = 0.0
    """Raised by this, scene units: a splat with its own flat base would mix with the ground."""
    copies: tuple[CopyTable, ...] = ()
    """Further instances; they have the object's name, and so its label and its queries."""
    queries: Annotated[tuple[Text, ...], Field(min_length=1)]
    """Wordings that mean it."""

    def places(self) -> tuple[CopyTable, ...]:
        """Where its instances stand: its own place, then those of its copies."""
        return (CopyTable(position=self.position, yaw=self.yaw), *self.copies)


class SplatTable(ObjectTable):
    """A thing that was captured as a splat."""

    file: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-][A-Za-z0-9_.-]*\.(ply|splat)$")]
    """File in the folder of splats."""
    up: Direction
    """The direction, in the file's frame, that shall point up."""
    front: Direction
    """The direction, in the file's frame, that shall point to the front (-y) at yaw 0."""
    height: Positive
    """Height in the scene, scene units: from the lowest to the highest 1 % of the Gaussians."""
    keep_within: tuple[Vector, Vector] | None = None
    """Lower and upper corner, in the file's frame; Gaussians with a centre outside are left out."""

    @field_validator("front")
    @classmethod
    def _differs_from_up(cls, front: Vector, info: ValidationInfo) -> Vector:
        up = info.data.get("up")
        if up is not None and np.linalg.norm(np.cross(up, front)) < 1e-6:
            raise ValueError(f"along up {up}; a direction that differs is accepted")
        return front

    def upright(self, yaw: float | None = None) -> NDArray[np.float64]:
        """(3, 3) rotation from the file's frame to the world's: z up, the front where yaw says.

        Args:
            yaw: Degrees; None for the object's own.
        """
        z = unit(self.up)
        y = -np.asarray(self.front, np.float64)
        y = unit(y - z * (y @ z))
        rotation: NDArray[np.float64] = about_z(self.yaw if yaw is None else yaw) @ np.stack(
            [np.cross(y, z), y, z]
        )
        return rotation


class PhotographTable(ObjectTable):
    """A box with a photograph on its four sides and its top."""

    photograph: Annotated[str, AfterValidator(_known_photograph)]
    """Name in `datasets.photographs.PHOTOGRAPHS`."""
    size: tuple[Positive, Positive, Positive]
    """Width (x), depth (y) and height (z) at yaw 0, scene units."""
    pitch: Positive
    """Distance between neighbouring Gaussians, scene units."""


class FlatTable(ObjectTable, TextureTable):
    """A flat area on the ground: a rug, a lawn."""

    size: tuple[Positive, Positive]
    """Extent in x and y at yaw 0, scene units."""
    lift: FiniteFloat = 0.01
    """Height above the ground, scene units. There is no ground underneath."""


def about_z(degrees: float) -> NDArray[np.float64]:
    """(3, 3) rotation about the vertical, from x towards y."""
    turn = np.radians(degrees)
    return np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])


SOURCES = {"file": SplatTable, "photograph": PhotographTable, "texture": FlatTable}
"""The key that says what a thing is made from."""


def _source(value: Any) -> str | None:
    if isinstance(value, dict):
        found = [key for key in SOURCES if key in value]
        return f"<{found[0]}>" if len(found) == 1 else None
    return next((f"<{key}>" for key, kind in SOURCES.items() if type(value) is kind), None)


AnyObject = Annotated[
    Annotated[SplatTable, Tag("<file>")]
    | Annotated[PhotographTable, Tag("<photograph>")]
    | Annotated[FlatTable, Tag("<texture>")],
    Discriminator(
        _source,
        custom_error_type="object_source",
        custom_error_message="a table with exactly one of the keys file, photograph and texture"
        " is accepted",
    ),
]
"""Any kind of thing, told apart by its source."""
