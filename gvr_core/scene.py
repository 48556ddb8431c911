"""A scene to ground in, and the questions asked of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from gvr_core.cameras import Camera, up_vector
from gvr_core.gaussians import Gaussians


@dataclass(frozen=True, eq=False)
class View:
    """One posed picture of a scene."""

    name: str
    """Unique in the scene; the picture's file stem."""
    camera: Camera
    image: Path | None = None
    """The photograph, where there is one; renders of the Gaussians stand in otherwise."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Gaussians and the views that a method may look at."""

    dataset: str
    name: str
    gaussians: Gaussians
    views: tuple[View, ...]
    """The n knowledge views: patches, features and depth come from these."""
    up: NDArray[np.float64] | None = None
    """(3,) up direction where the data set states one; else it is taken from the cameras."""

    @cached_property
    def up_direction(self) -> NDArray[np.float64]:
        """(3,) unit vector: the stated up direction, or the mean of the cameras' up axes."""
        if self.up is not None:
            return self.up
        return up_vector([view.camera for view in self.views]).direction


class Query(BaseModel):
    """A text, and the object of the ground truth that it means."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    id: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")
    """Unique in the scene; safe as a file name."""
    text: str = Field(min_length=1, max_length=400)
    """The words given to the method."""
    target: str | None = None
    """Name of the object meant; None where the scene does not hold it, or nobody knows."""
    absent: bool = False
    """True where the object is known not to be in the scene: refusing is then right."""
