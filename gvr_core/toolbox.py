"""What every method works with."""

from __future__ import annotations

from dataclasses import dataclass

from gvr_core.models.base import Models
from gvr_core.rendering.base import Renderer


@dataclass(frozen=True)
class Toolbox:
    """A renderer and the models."""

    renderer: Renderer
    models: Models
