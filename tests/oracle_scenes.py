"""Data sets with oracle models: what is judged on them is the geometry of a method."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from datasets.base import SceneData
from gvr_core.books import Books
from gvr_core.methods import Grounding, Method, MethodConfig, Toolbox, build_method
from gvr_core.metrics import flags_3d
from gvr_core.models.base import Models
from gvr_core.models.oracle import OracleWorld, oracle_models
from gvr_core.rendering import get_renderer
from gvr_core.scene import Query


@dataclass(frozen=True, eq=False)
class OracleScene:
    """A labelled scene, and models that know its labels."""

    data: SceneData

    @cached_property
    def world(self) -> OracleWorld:
        labels = self.data.truth.labels
        assert labels is not None
        meanings = {query.text: query.target for query in self.data.queries if query.target}
        return OracleWorld(self.data.scene.gaussians, labels, self.data.truth.objects, meanings)

    @property
    def models(self) -> Models:
        return oracle_models(self.world)

    def method(self, config: MethodConfig, models: Models | None = None) -> Method:
        return build_method(config, Toolbox(get_renderer("numba"), models or self.models))

    @cached_property
    def books(self) -> Books:
        """The books of gvr-robust; those of gvr-paper are the same without an index."""
        return self.method(MethodConfig(method="gvr-robust")).prepare(self.data.scene)

    @property
    def present(self) -> list[Query]:
        """One query for each object that is there."""
        first = {query.target: query for query in reversed(self.data.queries) if query.target}
        return list(reversed(first.values()))

    @property
    def absent(self) -> list[Query]:
        return [query for query in self.data.queries if query.absent]

    def truth(self, query: Query) -> NDArray[np.bool_]:
        assert query.target is not None
        flags = self.data.truth.flags(query.target)
        assert flags is not None
        return flags

    def scores(self, grounding: Grounding, query: Query) -> dict[str, float]:
        means = self.data.scene.gaussians.means
        return flags_3d(grounding.flags, self.truth(query), means, grounding.location)
