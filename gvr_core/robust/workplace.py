"""What (C) of ``gvr-robust`` works with: the scene, its virtual lens, and how a mask is judged."""

from __future__ import annotations

from collections.abc import Sequence
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
from gvr_core.workspace import Workspace

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
    shared: Workspace
    """What the queries of the scene share."""

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

    def draw(self, cameras: Sequence[Camera], drawn: BoolArray) -> list[Frame]:
        """Pictures of some of the Gaussians (N,)."""
        gaussians, renderer = self.scene.gaussians, self.tools.renderer
        pictures = renderer.render_many(gaussians, cameras, self.background, drawn)
        return [
            Frame.of_rendering(picture, camera, drawn)
            for picture, camera in zip(pictures, cameras, strict=True)
        ]

    def weights(self, camera: Camera, mask: BoolArray, drawn: BoolArray) -> Weights:
        """What counts of the Gaussians drawn inside and outside of a mask; each (N,)."""
        if not self.config.weight_filter:
            return centre_weights(self.scene.gaussians, camera, mask, drawn)
        return mask_weights(self.tools.renderer, self.scene.gaussians, camera, mask, drawn)

    def view_weights(self, view: int, mask: BoolArray) -> Weights:
        """The same of all Gaussians in a knowledge view.

        What a Gaussian has in the whole view does not depend on the query and is kept, so that
        for other masks of the view only the tiles under them are drawn. The rest of it is
        outside of the mask.
        """
        gaussians, camera = self.scene.gaussians, self.scene.views[view].camera
        if not self.config.weight_filter:
            return centre_weights(gaussians, camera, mask)
        renderer = self.tools.renderer
        inside: FloatArray | None = None

        def draw_all() -> FloatArray:
            nonlocal inside
            masks = np.stack([mask, np.ones_like(mask)])
            both: FloatArray = renderer.weights(gaussians, camera, masks).toarray()
            inside = both[:, 0].copy()
            return both[:, 1].copy()

        whole = self.shared.recall(b"weights of view %d" % view, draw_all)
        if inside is None:
            inside = renderer.weights(gaussians, camera, mask[None]).toarray()[:, 0]
        return inside, np.maximum(whole - inside, 0)

    def keeps(
        self, camera: Camera, mask: BoolArray, drawn: BoolArray, weights: Weights
    ) -> BoolArray:
        """(N,) the drawn Gaussians that one view's mask keeps.

        What the view sees is judged by its weights. Of what is hidden in it weights say nothing:
        that is judged by the column under the mask, as everything is without weights.

        Args:
            camera: The view's camera.
            mask: (H, W).
            drawn: (N,) the Gaussians drawn.
            weights: Their :meth:`weights`.
        """
        column = frustum_filter(self.scene.gaussians, camera, mask, drawn)
        if not self.config.weight_filter:
            return column
        ballot = Ballot(len(self.scene.gaussians))
        ballot.add(weights, 1.0)
        return np.where(ballot.seen, ballot.inside > ballot.outside, column)

    def pixel_area(self, camera: Camera, location: Float64Array) -> float:
        """Area that a pixel covers at a place, in those of the typical knowledge view.

        A near view has more pixels on an object than a far one, and no more to say.
        """
        away = np.linalg.norm(self._eyes - location, axis=1)
        return _area(camera, location) / float(np.median(away**2 / self._focal_areas))

    @cached_property
    def _eyes(self) -> Float64Array:
        return np.stack([view.camera.position for view in self.scene.views])

    @cached_property
    def _focal_areas(self) -> Float64Array:
        return np.array([view.camera.K[0, 0] * view.camera.K[1, 1] for view in self.scene.views])


def _area(camera: Camera, location: Float64Array) -> float:
    away = float(np.linalg.norm(camera.position - location))
    return away**2 / float(camera.K[0, 0] * camera.K[1, 1])
