"""``gvr-robust``: Grounding via View Retrieval with its weak places mended.

(A) as in the paper, and once for a scene: the up direction, and what hangs alone in the air.
(B) relevancy against canonical phrases -> every patch that passes the gate -> its surface by
median depth -> density clusters -> one place for each instance, or "not here".
(C) for each place: a bird's-eye view clipped above the object, if cameras have seen it from there
-> coarse set, joined with what the retrieved views' patches lift -> ring -> every view votes by
what it sees -> neighbours decide for the rest. Areas are lifted from the views alone.

Each of these is a switch of :class:`gvr_core.robust.config.RobustConfig`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gvr_core.books import Books
from gvr_core.cameras import up_vector
from gvr_core.localize import Localization
from gvr_core.methods.base import Grounding, nothing_found, prepare_books
from gvr_core.robust.calibration import calibration_of
from gvr_core.robust.config import NEGATIVES, RobustConfig
from gvr_core.robust.floaters import steady
from gvr_core.robust.ground_plane import ground_up
from gvr_core.robust.locating import find_places
from gvr_core.robust.relevancy import contrast, relevancy
from gvr_core.robust.segmenting import Segmented, segment_area, segment_thing
from gvr_core.robust.workplace import Workplace
from gvr_core.scene import Query, Scene
from gvr_core.stopwatch import recorded, step
from gvr_core.toolbox import Toolbox
from gvr_core.workspace import Workspace


@dataclass(frozen=True)
class GVRRobust:
    """The robust method.

    Args:
        tools: Renderer and models.
        config: The switches.
        background: Colour behind the renders.
        name: The name to report.
    """

    tools: Toolbox
    config: RobustConfig
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name: str = "gvr-robust"

    def prepare(self, scene: Scene) -> Books:
        """(A) The books, and the index made from them."""
        books = prepare_books(scene, self.tools, self.background)
        return replace(books, index=self.index(scene, books))

    def index(self, scene: Scene, books: Books) -> dict[str, NDArray[Any]]:
        """The up direction ``up`` (3,), and the Gaussians to draw in virtual views, ``steady``."""
        if scene.up is not None:
            up = scene.up
        elif self.config.ground_up:
            up = ground_up(scene.views, books.depths)
        else:
            up = up_vector([view.camera for view in scene.views]).direction
        everything = np.ones(len(scene.gaussians), np.bool_)
        drawn = steady(scene.gaussians) if self.config.floaters else everything
        return {"up": np.asarray(up, np.float64), "steady": drawn}

    def share(self, scene: Scene, books: Books, queries: Sequence[Query]) -> Workspace:
        """The queries' texts and the canonical phrases."""
        texts = [*NEGATIVES, *(query.text for query in queries)]
        return Workspace(books.semantics.features, self.tools.models.encoder, texts)

    def ground(self, scene: Scene, books: Books, query: Query) -> Grounding:
        """(B) then (C)."""
        shared = self.share(scene, books, [query])
        place = self.locate(scene, books, query, shared)
        return self.segment(scene, books, place, query, shared)

    def locate(
        self, scene: Scene, books: Books, query: Query, shared: Workspace | None = None
    ) -> Localization:
        """(B) Every place at which the views agree; none where the object is not here."""
        shared = shared or self.share(scene, books, [query])
        config, cosines = self.config, shared.cosines(query.text)
        calibration = calibration_of(self.tools.models.encoder.name, config.phrases)
        with step("relevancy"):
            if config.canonical_negatives and calibration.phrases:
                phrases = np.stack([shared.cosines(phrase) for phrase in NEGATIVES])
                scores = relevancy(cosines, phrases, config.temperature)
            else:
                scores = contrast(cosines, config.temperature)
        least = config.refuse_below
        if least is None:
            least = calibration.refuse_below
        return find_places(books, scene.views, scores, config, least)

    def segment(
        self,
        scene: Scene,
        books: Books,
        localization: Localization | None,
        query: Query,
        shared: Workspace | None = None,
    ) -> Grounding:
        """(C) From each place to the Gaussians there, and all instances together."""
        if localization is None or not localization.places:
            sureness = 0.0 if localization is None else localization.confidence
            return nothing_found(scene, localization, sureness)
        shared = shared or self.share(scene, books, [])
        level = replace(scene, up=books.index["up"])
        drawn = books.index["steady"].astype(np.bool_)
        work = Workplace(level, books, self.tools, self.config, drawn, self.background, shared)
        with recorded() as seconds:
            if localization.is_stuff:
                parts: list[Segmented] = [segment_area(work, localization)]
            else:
                parts = [
                    segment_thing(work, localization, i, query.text)
                    for i in range(len(localization.places))
                ]
        instances = tuple(part.flags for part in parts if part.flags.any())
        flags = np.logical_or.reduce([part.flags for part in parts])
        return Grounding(
            flags=flags,
            scores=np.maximum.reduce([part.scores for part in parts]),
            location=localization.location,
            found=bool(flags.any()),
            confidence=localization.confidence,
            instances=instances,
            seconds=seconds,
            localization=localization,
            bev=parts[0].bev,
            ring=parts[0].ring,
        )
