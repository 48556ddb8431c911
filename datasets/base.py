"""What every data set yields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from datasets.images import read_mask
from gvr_core.errors import DatasetError
from gvr_core.metrics import FLAGS_3D, IN_SCENE_2D, REFUSAL
from gvr_core.protocols.base import Box
from gvr_core.scene import Query, Scene, View

OWN_PROTOCOLS = (IN_SCENE_2D, FLAGS_3D, REFUSAL)
"""What a scene with exact masks and labels in 3D is scored under."""


@runtime_checkable  # flows take scenes as parameters, and Prefect asks what these are
class MaskMaker(Protocol):
    """A mask that is made when it is asked for: polygons, a picture with a rule of its own."""

    def pixels(self) -> NDArray[np.bool_]:
        """(H, W) True inside."""
        ...


MaskSource = Path | MaskMaker
"""Where a mask is: a picture in the project's own layout, or something that makes it."""


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """What is known of a scene's objects: exact masks in test views, and labels in 3D."""

    objects: tuple[str, ...]
    """Names of the labelled objects."""
    test_views: tuple[View, ...]
    """The views in which predictions are scored."""
    masks: Mapping[tuple[str, str], MaskSource] = field(default_factory=dict)
    """(view name, object name) -> mask; pairs that are not labelled have none."""
    labels: NDArray[np.int16] | None = None
    """(N,) index into ``objects`` per Gaussian, -1 for the rest; None where 3D is not labelled."""
    boxes: Mapping[tuple[str, str], tuple[Box, ...]] = field(default_factory=dict)
    """(view name, object name) -> the labels' boxes, where the data set states them."""

    def mask(self, view: View, target: str) -> NDArray[np.bool_]:
        """The exact mask (H, W) of an object in a test view; all False where it is not visible."""
        shape = (view.camera.height, view.camera.width)
        source = self.masks.get((view.name, target))
        if source is None:
            return np.zeros(shape, dtype=np.bool_)
        if isinstance(source, Path):
            return read_mask(source, size=(view.camera.width, view.camera.height))
        return source.pixels()

    def is_labelled(self, view: View, target: str) -> bool:
        """Whether an object was labelled in a test view; its mask may be empty all the same."""
        return (view.name, target) in self.masks

    def flags(self, target: str) -> NDArray[np.bool_] | None:
        """The exact flags (N,) of an object's Gaussians, or None where 3D is not labelled.

        Raises:
            DatasetError: for a name that is not among the objects.
        """
        if target not in self.objects:
            raise DatasetError(f"unknown object {target!r}", accepted=", ".join(self.objects))
        if self.labels is None:
            return None
        return self.labels == self.objects.index(target)


@dataclass(frozen=True, eq=False)
class SceneData:
    """One scene of a data set, with its questions and their answers."""

    scene: Scene
    queries: tuple[Query, ...]
    truth: GroundTruth
    digests: Mapping[str, str]
    """sha256 of the content behind each part: ``gaussians``, ``views``, ``queries``, ``truth``.
    They go into the cache keys, so that changing one part recomputes only what depends on it."""
    protocols: tuple[str, ...] = OWN_PROTOCOLS
    """Ids of the protocols that predictions on this scene are scored under, the main one first."""
    notes: tuple[str, ...] = ()
    """What had to be put right or left out on reading, with counts; said to the user."""
    original: bool = False
    """Whether it is taken for the data that published numbers are on."""


class Dataset(Protocol):
    """A named set of scenes."""

    @property
    def name(self) -> str:
        """The data set's name in suites, tables and MLflow."""
        ...

    def scenes(self) -> Sequence[str]:
        """Names of the scenes, in table order."""
        ...

    def load(self, scene: str) -> SceneData:
        """Read one scene.

        Raises:
            ConfigError: for a scene that the data set does not have.
            InputError: for files that are not as the layout says.
        """
        ...
