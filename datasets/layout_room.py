"""What stands around the things of a layout without a label: ground, surfaces, floaters."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from datasets.layout_tables import (
    Direction,
    Positive,
    PositiveRange,
    Table,
    TextureTable,
    UnitRange,
    Vector,
)


class GroundTable(TextureTable):
    """``[ground]``: a textured rectangle at z = 0, its middle at the origin."""

    size: tuple[Positive, Positive]
    """Extent in x and y, scene units."""


class SurfaceTable(TextureTable):
    """``[[surfaces]]``: a textured rectangle anywhere, seen from both sides."""

    corner: Vector
    """Where the texture's top left corner lies, scene units."""
    right: Direction
    """Along the texture's upper edge, from its left to its right end, scene units."""
    down: Direction
    """Along its left edge, from the top to the bottom, scene units."""

    @model_validator(mode="after")
    def _check_edges(self) -> SurfaceTable:
        right, down = np.asarray(self.right), np.asarray(self.down)
        if abs(right @ down) > 1e-6 * np.linalg.norm(right) * np.linalg.norm(down):
            raise ValueError("right and down are not perpendicular")
        return self


class FloatersTable(Table):
    """``[floaters]``: blobs of random colour in the air, as badly trained scenes have them."""

    count: Annotated[int, Field(ge=1, le=100_000)]
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    """Decides where they are and how they look."""
    lower: Vector
    """Corner of the region, scene units: centres are spread evenly over it."""
    upper: Vector
    """The opposite corner."""
    size: PositiveRange
    """Smallest and largest standard deviation along an axis, scene units."""
    opacity: UnitRange
    """Lowest and highest opacity."""

    @model_validator(mode="after")
    def _check_corners(self) -> FloatersTable:
        if any(low >= high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ValueError("lower is not below upper along every axis")
        return self
