"""A data set that another installed package brings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from datasets.base import Dataset, SceneData
from datasets.digests import digest_of
from gvr_core.plugins import Plugin

PARTS = ("name", "scenes", "load")
"""What it must have; see :class:`datasets.base.Dataset`."""
DIGESTS = ("gaussians", "views", "queries", "truth")
"""The parts of a scene that have a digest; see :class:`datasets.base.SceneData`."""


class PluginDataset:
    """A plugin's data set, held to what all data sets keep to.

    The digests of its scenes take in the plugin's origin: another version of a reader may read
    the same files differently.

    Args:
        plugin: Makes the data set.
        settings: What the data set is told.

    Raises:
        PluginError: if it does not take its settings, or goes by another name.
    """

    def __init__(self, plugin: Plugin, settings: Mapping[str, Any]) -> None:
        self._plugin = plugin
        self._made: Dataset = plugin.made(PARTS, **settings)
        self.name = plugin.name
        if self._made.name != self.name:  # results are found again by it
            raise plugin.error(
                f"the data set calls itself {self._made.name!r}", f"the name {self.name!r}"
            )

    def scenes(self) -> Sequence[str]:
        """Names of the scenes, in the plugin's order."""
        return tuple(self._made.scenes())

    def load(self, scene: str) -> SceneData:
        """Read one scene.

        Raises:
            PluginError: for what is no scene of that name, or lacks a digest.
            InputError: as the plugin raises it.
        """
        data = self._made.load(scene)
        if not isinstance(data, SceneData):
            raise self._plugin.error(
                f"scene {scene!r} is a {type(data).__name__}", "datasets.base.SceneData"
            )
        called = (data.scene.dataset, data.scene.name)
        if called != (self.name, scene):
            raise self._plugin.error(
                f"scene {scene!r} is called {'/'.join(called)}", f"{self.name}/{scene}"
            )
        missing = [part for part in DIGESTS if not data.digests.get(part)]
        if missing:
            raise self._plugin.error(
                f"scene {scene!r} has no digest of its {', '.join(missing)}",
                f"sha256 of {', '.join(DIGESTS)}",
            )
        origin = self._plugin.origin
        digests = {part: digest_of([origin, digest]) for part, digest in data.digests.items()}
        return replace(data, digests=digests)
