"""What every grounding method takes and gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gvr_core import preparation
from gvr_core.books import Books
from gvr_core.localize import Localization
from gvr_core.scene import Query, Scene
from gvr_core.segment import VirtualView
from gvr_core.toolbox import Toolbox
from gvr_core.workspace import Workspace


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
    given: Mapping[str, NDArray[Any]] | None = None
    """View name -> what a method of pictures says there, instead of flags: (H, W) uint8 grey mask
    or (L, H, W) float32 relevancy maps. None for methods that flag Gaussians."""
    answered: bool = True
    """Whether there is an answer at all; others' predictions may lack one."""


class Method(Protocol):
    """A way to ground text in Gaussians.

    ``prepare`` and ``ground`` are the whole of it. A workflow that caches the steps apart calls
    ``index`` after the books are made, then ``share`` with all queries, and for each of them
    ``locate`` and ``segment``. Answers are the same, bit for bit, whichever queries share.
    """

    @property
    def name(self) -> str:
        """The method's name in suites, tables and MLflow."""
        ...

    def prepare(self, scene: Scene) -> Books:
        """Everything that can be done before a query is known, the index included."""
        ...

    def index(self, scene: Scene, books: Books) -> dict[str, NDArray[Any]]:
        """The method's own part of the preparation, made from the other books; may be empty."""
        ...

    def share(self, scene: Scene, books: Books, queries: Sequence[Query]) -> Workspace:
        """What these queries share: their texts, encoded together, and room for what else."""
        ...

    def ground(self, scene: Scene, books: Books, query: Query) -> Grounding:
        """Answer one query."""
        ...

    def locate(
        self, scene: Scene, books: Books, query: Query, shared: Workspace | None = None
    ) -> Localization | None:
        """Where the query's object is; None where the method cannot tell or does not ask.

        Args:
            scene: The scene.
            books: Its books.
            query: The query.
            shared: What :meth:`share` gave for this and other queries; None for this one alone.
        """
        ...

    def segment(
        self,
        scene: Scene,
        books: Books,
        localization: Localization | None,
        query: Query,
        shared: Workspace | None = None,
    ) -> Grounding:
        """Which Gaussians are the query's object, given where it is.

        Args:
            scene: The scene.
            books: Its books.
            localization: What :meth:`locate` gave.
            query: The query.
            shared: As of :meth:`locate`.
        """
        ...


def prepare_books(
    scene: Scene, tools: Toolbox, background: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Books:
    """(A) The Semantic Vector Book and the Depth Book of a scene's views; no index yet.

    Args:
        scene: The scene.
        tools: Renderer and models.
        background: Colour behind the renders.
    """
    renderer, models = tools.renderer, tools.models
    views = preparation.render_views(scene.gaussians, scene.views, renderer, background)
    depths = preparation.render_depths(scene.gaussians, scene.views, renderer)
    patches = preparation.segment_views(views, depths, scene.views, models.segmenter)
    semantics = preparation.encode_patches(views, depths, scene.views, patches, models.encoder)
    return Books(views, depths, semantics)


def nothing_found(
    scene: Scene, localization: Localization | None = None, confidence: float = 0.0
) -> Grounding:
    """The answer "not here"."""
    flags = np.zeros(len(scene.gaussians), dtype=np.bool_)
    return Grounding(
        flags,
        flags.astype(np.float32),
        None,
        found=False,
        confidence=confidence,
        localization=localization,
    )
