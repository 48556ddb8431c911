"""``gvr-paper``: Grounding via View Retrieval, step by step as the paper has it.

(A) prepare: render the views and their depth, cut them into patches, encode the patches.
(B) locate: text -> best patch of each view -> L_2D -> L_3D of each view -> votes -> L_3D.
(C) segment: bird's-eye view at L_3D -> point-prompted mask -> coarse set -> k ring views ->
text masks -> intersection -> I_tar.

Where the paper is silent, the reading taken is documented where it is taken: the position of a
patch (:func:`gvr_core.run_lengths.patch_positions`), the voting radius
(:func:`~gvr_core.localize.voting_radius`), the up direction
(:func:`gvr_core.cameras.up_vector`), where the bird's-eye camera stands
(:data:`gvr_core.paper.BEV_DISTANCE_FACTOR`, and without RFL
:func:`gvr_core.segment.focus_point`), the target's width
(:func:`gvr_core.segment.target_width`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from gvr_core import paper
from gvr_core.books import Books
from gvr_core.localize import Localization, localize
from gvr_core.methods.base import (
    Grounding,
    nothing_found,
    prepare_books,
)
from gvr_core.scene import Query, Scene
from gvr_core.segment import (
    birds_eye_view,
    coarse_by_point,
    coarse_by_text,
    focus_point,
    intersect,
    surrounding_views,
)
from gvr_core.stopwatch import recorded
from gvr_core.toolbox import Toolbox
from gvr_core.workspace import Workspace


class LocateConfig(BaseModel):
    """Settings of (B), retrieval for localising."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rfl: bool = True
    """Off: the ablation without RFL; the text mask on the bird's-eye view replaces retrieval."""
    top_k: int | None = Field(default=paper.TOP_K_VIEWS, ge=1)
    """Only so many views vote, those with the most similar patches; None for all."""
    vote_radius: float = Field(default=paper.VOTE_RADIUS_FRACTION, gt=0)
    """Voting radius as a fraction of the viewing distance."""
    depth: str = Field(default="expected", pattern="^(expected|median)$")
    """Which depth back-projects a patch."""


class SegmentConfig(BaseModel):
    """Settings of (C), online segmentation."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    smfi: bool = True
    """Off: the ablation without SMFI; the coarse set is the answer."""
    bev_distance: float = Field(default=paper.BEV_DISTANCE_FACTOR, gt=0)
    """Height of the bird's-eye camera, in mean distances of the knowledge cameras."""
    ring_views: int = Field(default=paper.RING_VIEWS_K, ge=1)
    """k: number of ring cameras."""
    ring_distance: float = Field(default=paper.RING_DISTANCE_FACTOR, gt=0)
    """d_vir in widths of the coarse target."""
    ring_pitch: float = Field(default=paper.RING_PITCH_DEGREES, gt=-90, lt=90)
    """Pitch of the ring cameras, degrees."""
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Colour behind the renders, each channel in [0, 1]."""


@dataclass(frozen=True)
class GVRPaper:
    """The paper's method.

    Args:
        tools: Renderer and models.
        locating: Settings of (B).
        segmenting: Settings of (C).
        name: The name to report; a control with other models has its own.
    """

    tools: Toolbox
    locating: LocateConfig = field(default_factory=LocateConfig)
    segmenting: SegmentConfig = field(default_factory=SegmentConfig)
    name: str = "gvr-paper"

    def prepare(self, scene: Scene) -> Books:
        """(A) The Semantic Vector Book and the Depth Book of the scene's views."""
        return prepare_books(scene, self.tools, self.segmenting.background)

    def index(self, scene: Scene, books: Books) -> dict[str, NDArray[Any]]:
        """Nothing: the books are all that the paper prepares."""
        return {}

    def share(self, scene: Scene, books: Books, queries: Sequence[Query]) -> Workspace:
        """The queries' texts; without RFL none is asked for here."""
        texts = [query.text for query in queries] if self.locating.rfl else []
        return Workspace(books.semantics.features, self.tools.models.encoder, texts)

    def ground(self, scene: Scene, books: Books, query: Query) -> Grounding:
        """(B) then (C)."""
        shared = self.share(scene, books, [query])
        place = self.locate(scene, books, query, shared)
        return self.segment(scene, books, place, query, shared)

    def locate(
        self, scene: Scene, books: Books, query: Query, shared: Workspace | None = None
    ) -> Localization | None:
        """(B) L_3D by view retrieval; None without RFL, or where no view puts a patch forward."""
        if not self.locating.rfl:
            return None
        shared = shared or self.share(scene, books, [query])
        return localize(
            shared.cosines(query.text),
            books.semantics.patches,
            books.depths,
            scene.views,
            self.locating.top_k,
            self.locating.depth,
            self.locating.vote_radius,
        )

    def segment(
        self,
        scene: Scene,
        books: Books,
        localization: Localization | None,
        query: Query,
        shared: Workspace | None = None,
    ) -> Grounding:
        """(C) From L_3D, or without RFL from the text alone, to the target Gaussians."""
        place = None if localization is None else localization.location
        if self.locating.rfl and place is None:
            return nothing_found(scene, localization)
        with recorded() as seconds:
            answer = self._segment(scene, localization, query.text)
        return replace(answer, seconds=seconds)

    def _segment(self, scene: Scene, localization: Localization | None, text: str) -> Grounding:
        place = None if localization is None else localization.location
        config, models = self.segmenting, self.tools.models
        centre = focus_point([view.camera for view in scene.views]) if place is None else place
        bev = birds_eye_view(
            scene, centre, self.tools.renderer, config.bev_distance, config.background
        )
        if place is None:
            coarse, bev_view = coarse_by_text(scene, bev, text, models.text_segmenter)
        else:
            coarse, bev_view = coarse_by_point(scene, bev, centre, models.segmenter)
        location = centre
        if place is None and coarse.any():
            location = np.median(scene.gaussians.means[coarse], axis=0).astype(np.float64)

        flags, ring = coarse, []
        if config.smfi and coarse.any():
            ring = surrounding_views(
                scene,
                coarse,
                location,
                text,
                self.tools.renderer,
                models.text_segmenter,
                config.ring_views,
                config.ring_distance,
                config.ring_pitch,
                config.background,
            )
            flags = intersect(scene.gaussians, coarse, ring)
        found = bool(flags.any())
        return Grounding(
            flags=flags,
            scores=flags.astype(np.float32),
            location=location if place is not None or coarse.any() else None,
            found=found,
            confidence=0.0 if localization is None else localization.confidence,
            instances=(flags,) if found else (),
            localization=localization,
            bev=bev_view,
            ring=ring,
        )
