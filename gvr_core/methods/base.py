"""What every grounding method takes and gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gvr_core.books import Books
from gvr_core.localize import Localization
from gvr_core.models.base import Models
from gvr_core.rendering.base import Renderer
from gvr_core.scene import Query, Scene
from gvr_core.segment import VirtualView


@dataclass(frozen=True)
class Toolbox:
    """What a method works with: a renderer and the models."""

    renderer: Renderer
    models: Models


@dataclass(frozen=True, eq=False)
class Grounding:
    """The answer to a query: which Gaussians, where, how sure, and why."""

    flags: NDArray[np.bool_]
    """I_tar: (N,) flags of the target Gaussians."""
    scores: NDArray[np.float32]
    """(N,) soft membership in [0, 1]; the flags as numbers where a method has nothing softer."""
    location: NDArray[np.float64] | None
    """L_3D: (3,), world frame; None where the method has found no place."""
    found: bool
    """Whether the method says that the scene holds what the query names."""
    confidence: float
    """How sure the method is; comparable only within one method and its models."""
    instances: tuple[NDArray[np.bool_], ...] = ()
    """(N,) flags of each instance; the paper's method has at most one."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Step -> wall seconds."""
    localization: Localization | None = None
    """Evidence: retrieved views and patches, and their votes."""
    bev: VirtualView | None = None
    """Evidence: the bird's-eye view and its mask."""
    ring: Sequence[VirtualView] = ()
    """Evidence: the surrounding views and their masks."""


class Method(Protocol):
    """A way to ground text in Gaussians.

    ``prepare`` and ``ground`` are the whole of it. ``locate`` and ``segment`` are the two halves
    of ``ground``; a workflow that caches them apart calls them one after the other.
    """

    @property
    def name(self) -> str:
        """The method's name in suites, tables and MLflow."""
        ...

    def prepare(self, scene: Scene) -> Books:
        """Everything that can be done before a query is known."""
        ...

    def ground(self, scene: Scene, books: Books, query: Query) -> Grounding:
        """Answer one query."""
        ...

    def locate(self, scene: Scene, books: Books, query: Query) -> Localization | None:
        """Where the query's object is; None where the method cannot tell or does not ask."""
        ...

    def segment(self, scene: Scene, localization: Localization | None, query: Query) -> Grounding:
        """Which Gaussians are the query's object, given where it is."""
        ...
