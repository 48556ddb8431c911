"""What all tables of a layout file share: their types, strictness, and how they are dumped."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    SerializerFunctionWrapHandler,
    model_serializer,
)

Positive = Annotated[FiniteFloat, Field(gt=0)]
Point = tuple[FiniteFloat, FiniteFloat]
Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Text = Annotated[str, Field(min_length=1, max_length=400)]
Unit = Annotated[float, Field(ge=0, le=1)]


def _has_direction(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(abs(x) > 1e-9 for x in vector):
        raise ValueError("no direction: a vector that is not zero is accepted")
    return vector


def _ascending(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError("the lower end comes first")
    return pair


Direction = Annotated[Vector, AfterValidator(_has_direction)]
"""A vector of any length but zero."""
PositiveRange = Annotated[tuple[Positive, Positive], AfterValidator(_ascending)]
UnitRange = Annotated[tuple[Unit, Unit], AfterValidator(_ascending)]
"""Lowest and highest value."""


class Table(BaseModel):
    """A TOML table: what it does not know, it refuses."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    ADDED_LATER: ClassVar[tuple[str, ...]] = ()
    """Keys that the first layouts did not have. A dump leaves them out where they are as by
    default: a scene's recipe is the digest of the dump, and has to stay when the format grows."""

    @model_serializer(mode="wrap")
    def _dump(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        dumped: dict[str, Any] = dump(self)
        for key in self.ADDED_LATER:
            if getattr(self, key) == type(self).model_fields[key].default:
                del dumped[key]
        return dumped


class TextureTable(Table):
    """The keys of everything that is a textured rectangle."""

    texture: Literal["brick", "grass", "gravel", "wood"]
    tint: tuple[Unit, Unit, Unit]
    """Mean colour."""
    contrast: Annotated[float, Field(ge=0, le=2)] = 1.0
    """Factor on the texture's own variation."""
    repeat: Annotated[int, Field(ge=1, le=16)] = 1
    """How often the texture is laid side by side, each way."""
    pitch: Positive
    """Distance between neighbouring Gaussians, scene units."""
