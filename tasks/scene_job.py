"""One method on one scene: what its stages need, and what their cache keys are made of."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from datasets.base import SceneData
from gvr_core.methods import MethodConfig, Toolbox
from gvr_core.robust.calibration import calibration_of
from gvr_core.scene import Query
from tasks.store import Store, canonical_json

Track = Callable[[Iterable[Any], str], Iterable[Any]]
"""Wraps a loop, e.g. in a progress bar; the text says what is being done."""


def _untracked(items: Iterable[Any], text: str) -> Iterable[Any]:
    return items


@dataclass(frozen=True, eq=False)
class SceneJob:
    """One method on one scene: everything that its stages need."""

    store: Store
    data: SceneData
    queries: Sequence[Query]
    method: MethodConfig
    tools: Toolbox
    track: Track = field(default=_untracked)
    evidence: bool = False
    """Whether the steps behind each answer are kept as small pictures."""

    @property
    def label(self) -> str:
        """Data set and scene, for the names of task runs."""
        return f"{self.data.scene.dataset}/{self.data.scene.name}"

    def model_names(self) -> dict[str, str]:
        """Renderer and models, each with version, settings and digests of its weights.

        No models for a method that looks at no picture.
        """
        models = self.tools.models
        if not self.method.needs_books:
            return {"renderer": self.tools.renderer.name}
        return {
            "renderer": self.tools.renderer.name,
            "segmenter": models.segmenter.name,
            "encoder": models.encoder.name,
            "text_segmenter": models.text_segmenter.name,
        }

    def config(self) -> dict[str, Any]:
        """The whole configuration that results depend on, as JSON values."""
        none = dict.fromkeys(("segmenter", "encoder", "text_segmenter"), "none")
        names = none | self.model_names()
        return {
            "method": self.method.identity,
            **self.method.settings(),
            **names,
            "calibration": calibration_of(names["encoder"]).model_dump(mode="json"),
            "protocols": list(self.data.protocols),
            "evidence": self.evidence,
        }

    def digests(self) -> dict[str, str]:
        """sha256 of each part of the scene, and of the queries without and with their answers."""
        texts = [[query.id, query.text] for query in self.queries]
        answers = [query.model_dump() for query in self.queries]
        return {**self.data.digests, "texts": _digest(texts), "queries": _digest(answers)}


def _digest(value: object) -> str:
    return hashlib.sha256(canonical_json(value)).hexdigest()
