"""What (C) of ``gvr-robust`` works with: the scene, its virtual lens, and how a mask is judged."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gvr_core.books import Books
from gvr_core.cameras import Camera
from gvr_core.models.base import Frame
from gvr_core.robust.ballot import Ballot, centre_weights, mask_weights
from gvr_core.robust.config import RobustSegment
from gvr_core.scene import Scene
from gvr_core.segment import frustum_filter
from gvr_core.toolbox import Toolbox

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float32]
Float64Array = NDArray[np.float64]
Weights = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class Lens:
    """Intrinsics of the virtual cameras: those of a typical view, its principal point centred."""

    K: Float64Array
    """(3, 3), pixels."""
    width: int
    height: int

    @property
    def half_angle(self) -> float:
        """Half of the narrower field of view, radians."""
        narrow = min(self.width / self.K[0, 0], self.height / self.K[1, 1])
        return float(np.arctan(narrow / 2))


@dataclass(frozen=True, eq=False)
class Workplace:
    """A scene being worked on."""

    scene: Scene
    """With the up direction to use."""
    books: Books
    tools: Toolbox
    config: RobustSegment
    steady: BoolArray
    """(N,) the Gaussians to draw in virtual views."""
    background: tuple[float, float, float]

    @cached_property
    def lens(self) -> Lens:
        """The virtual cameras' intrinsics: medians over the views, so that no view sets them."""
        cameras = [view.camera for view in self.scene.views]
        width = int(np.median([camera.width for camera in cameras]))
        height = int(np.median([camera.height for camera in cameras]))
        fx = float(np.median([camera.K[0, 0] / camera.width for camera in cameras])) * width
        fy = float(np.median([camera.K[1, 1] / camera.height for camera in cameras])) * height
        K = np.array([[fx, 0, width / 2], [0, fy, height / 2], [0, 0, 1]])
        return Lens(K, width, height)

    def draw(self, camera: Camera, drawn: BoolArray) -> Frame:
        """A picture of some of the Gaussians (N,)."""
        shown = self.scene.gaussians.subset(drawn)
        rendering = self.tools.renderer.render(shown, camera, self.background)
        return Frame.of_rendering(rendering, camera, drawn)

    def weights(self, camera: Camera, mask: BoolArray, drawn: BoolArray | None) -> Weights:
        """What counts inside and outside of a mask: by weight, or by centre; each (N,)."""
        if self.config.weight_filter:
            gaussians = self.scene.gaussians
            return mask_weights(self.tools.renderer, gaussians, camera, mask, drawn)
        return centre_weights(self.scene.gaussians, camera, mask, drawn)

    def keeps(self, camera: Camera, mask: BoolArray, drawn: BoolArray) -> BoolArray:
        """(N,) the drawn Gaussians that one view's mask keeps.

        What the view sees is judged by its weights. Of what is hidden in it weights say nothing:
        that is judged by the column under the mask, as everything is without weights.
        """
        column = frustum_filter(self.scene.gaussians, camera, mask) & drawn
        if not self.config.weight_filter:
            return column
        ballot = Ballot(len(self.scene.gaussians))
        ballot.add(self.weights(camera, mask, drawn), 1.0)
        return np.where(ballot.seen, ballot.inside > ballot.outside, column)

    def pixel_area(self, camera: Camera, location: Float64Array) -> float:
        """Area that a pixel covers at a place, in those of the typical knowledge view.

        A near view has more pixels on an object than a far one, and no more to say.
        """
        areas = [_area(view.camera, location) for view in self.scene.views]
        return _area(camera, location) / float(np.median(areas))


def _area(camera: Camera, location: Float64Array) -> float:
    away = float(np.linalg.norm(camera.position - location))
    return away**2 / float(camera.K[0, 0] * camera.K[1, 1])
