"""``lift``: a training-free baseline of another school.

Every patch's semantic vector is lifted onto the Gaussians by their rendering weights in the
patch; a query is compared with each Gaussian's own vector, and a threshold decides. There is no
localising and no segmenting at query time. Source of the idea: Marrie et al., "LUDVIG" (2024),
and Cheng et al., "Occam's LGS" (2024); this is the plain weighted mean that both start from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy import sparse

from gvr_core.books import Books
from gvr_core.localize import Localization
from gvr_core.methods.base import Grounding, nothing_found, prepare_books
from gvr_core.robust.ballot import UNSEEN
from gvr_core.robust.calibration import calibration_of
from gvr_core.robust.candidates import NEUTRAL
from gvr_core.robust.config import NEGATIVES
from gvr_core.robust.relevancy import over_phrases, over_typical, softmax
from gvr_core.scene import Query, Scene
from gvr_core.stopwatch import recorded, step
from gvr_core.toolbox import Toolbox
from gvr_core.workspace import Workspace

MASKS_AT_ONCE = 64
"""Masks of a view that are weighed in one walk, which bounds the memory."""
BEST_PERCENTILE = 99.0
"""The most relevant Gaussians are those above this percentile of the seen ones."""
LOCATION_SHARE = 0.1
"""The place of an answer is the median of this part of its Gaussians, the most relevant ones."""


class LiftConfig(BaseModel):
    """Settings of ``lift``."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    threshold: float = Field(default=0.5, gt=0, lt=1)
    """A Gaussian is the object where its relevancy is above this, and"""
    share: float = Field(default=0.5, ge=0, le=1)
    """where it rises above 0.5 by this part of what the most relevant ones do; the rule by which
    ``gvr-robust`` gates patches."""
    phrases: bool | None = None
    """Whether relevancy is against canonical phrases; None for what was calibrated."""
    temperature: float = Field(default=10.0, gt=0)
    """Of the softmax between query and canonical phrase, as in LERF."""


@dataclass(frozen=True)
class Lift:
    """The lifting baseline.

    Args:
        tools: Renderer and models.
        config: Its settings.
        background: Colour behind the renders of the views.
        name: The name to report.
    """

    tools: Toolbox
    config: LiftConfig
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name: str = "lift"

    def prepare(self, scene: Scene) -> Books:
        """The books, and every Gaussian's weights in every patch."""
        books = prepare_books(scene, self.tools, self.background)
        return replace(books, index=self.index(scene, books))

    def index(self, scene: Scene, books: Books) -> dict[str, NDArray[Any]]:
        """W (N x M), sparse, and the length of each lifted vector.

        W_gj is the sum over the pixels of patch j of alpha_g T; the lifted vector is
        F_g = sum_j W_gj f_j. Only its length (N,) is kept beside W: F_g t = sum_j W_gj (f_j t),
        so the N x c vectors themselves are never needed again.
        """
        patches, n = books.semantics.patches, len(scene.gaussians)
        columns = []
        for i, view in enumerate(scene.views):
            span = range(int(patches.view_ptr[i]), int(patches.view_ptr[i + 1]))
            for first in span[::MASKS_AT_ONCE]:
                masks = [patches.pixels(j) for j in span[first - span.start :][:MASKS_AT_ONCE]]
                drawn = self.tools.renderer.weights(scene.gaussians, view.camera, np.stack(masks))
                drawn.data[drawn.data <= UNSEEN] = 0
                drawn.eliminate_zeros()
                columns.append(drawn)
        nothing = sparse.csr_array((n, 0), dtype=np.float32)
        weights = sparse.hstack([nothing, *columns], format="csr", dtype=np.float32)
        return {
            "weights": weights.data,
            "patches": weights.indices.astype(np.int32),
            "row_ptr": weights.indptr.astype(np.int64),
            "lengths": _lengths(weights, books.semantics.features),
        }

    def share(self, scene: Scene, books: Books, queries: Sequence[Query]) -> Workspace:
        """The queries' texts and the canonical phrases."""
        texts = [*NEGATIVES, *(query.text for query in queries)]
        return Workspace(books.semantics.features, self.tools.models.encoder, texts)

    def ground(self, scene: Scene, books: Books, query: Query) -> Grounding:
        """Every Gaussian that is more like the query than like any canonical phrase."""
        return self.segment(scene, books, None, query)

    def locate(
        self, scene: Scene, books: Books, query: Query, shared: Workspace | None = None
    ) -> Localization | None:
        """Nothing: places are not asked for."""
        return None

    def segment(
        self,
        scene: Scene,
        books: Books,
        localization: Localization | None,
        query: Query,
        shared: Workspace | None = None,
    ) -> Grounding:
        """Every Gaussian that is more like the query than like any canonical phrase."""
        shared = shared or self.share(scene, books, [query])
        with recorded() as seconds, step("compare"):
            answer = self._compare(scene, books, query, shared)
        return replace(answer, seconds=seconds)

    def _compare(self, scene: Scene, books: Books, query: Query, shared: Workspace) -> Grounding:
        index, features = books.index, books.semantics.features
        weights = sparse.csr_array(
            (index["weights"], index["patches"], index["row_ptr"]),
            shape=(len(scene.gaussians), len(features)),
        )
        texts = np.stack([shared.cosines(text) for text in (query.text, *NEGATIVES)])
        lengths = index["lengths"][:, None]
        seen = index["lengths"] > 0
        cosines = np.divide(
            weights @ texts.T,
            lengths,
            out=np.zeros((len(seen), len(texts))),
            where=lengths > 0,
        )
        scores = np.zeros(len(seen), np.float32)
        scores[seen] = softmax(self._margin(cosines[seen]), self.config.temperature)
        best = float(np.percentile(scores[seen], BEST_PERCENTILE)) if seen.any() else 0.0
        least = NEUTRAL + self.config.share * (best - NEUTRAL)
        flags = scores > max(self.config.threshold, least)
        if not flags.any():
            return nothing_found(scene, None, best)
        core = flags & (scores >= np.quantile(scores[flags], 1 - LOCATION_SHARE))
        return Grounding(
            flags=flags,
            scores=flags.astype(np.float32),
            location=np.median(scene.gaussians.means[core], axis=0).astype(np.float64),
            found=True,
            confidence=best,
            instances=(flags,),
        )

    def _margin(self, cosines: NDArray[np.float32]) -> NDArray[np.float32]:
        """How much more like the query each Gaussian (s, 1 + phrases) is than like anything."""
        calibration = calibration_of(self.tools.models.encoder.name, self.config.phrases)
        if calibration.phrases:
            return over_phrases(cosines[:, 0], cosines[:, 1:].T)
        return over_typical(cosines[:, 0])


def _lengths(weights: sparse.csr_array, features: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N,) length of each Gaussian's lifted vector, a few thousand rows at a time."""
    lengths = np.zeros(weights.shape[0], np.float32)
    for first in range(0, weights.shape[0], 8192):
        lifted = weights[first : first + 8192] @ features
        lengths[first : first + 8192] = np.linalg.norm(lifted, axis=1)
    return lengths
