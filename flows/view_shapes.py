"""What the viewer draws, as plain arrays: splats, cameras, votes, rings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gvr_core.cameras import Camera
from gvr_core.gaussians import SH_C0, BoolArray, Gaussians
from gvr_core.scene import Scene

FloatArray = NDArray[np.float32]

VIEWED_RADIUS = 4.0
"""Radius of a scene as it is drawn. The browser keeps covariances in half precision, which has
nothing left for the small Gaussians of a small scene."""


@dataclass(frozen=True, eq=False)
class DisplayFrame:
    """From the scene's frame to the viewer's: moved to the middle, and scaled."""

    centre: NDArray[np.float64]
    """(3,) what is in the middle, scene units."""
    factor: float
    """Viewer units in a scene unit."""

    @classmethod
    def of(cls, scene: Scene) -> DisplayFrame:
        """The frame in which the middle half of the Gaussians fills the view."""
        means = scene.gaussians.means.astype(np.float64)
        centre = np.median(means, axis=0)
        radius = float(np.percentile(np.linalg.norm(means - centre, axis=1), 75))
        return cls(centre, VIEWED_RADIUS / radius if radius > 0 else 1.0)

    def place(self, points: NDArray[np.floating]) -> FloatArray:
        """Points (..., 3) of the scene as drawn."""
        return ((points - self.centre) * self.factor).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Splats:
    """Gaussians as the viewer takes them, in the display frame."""

    centers: FloatArray
    """(n, 3)."""
    covariances: FloatArray
    """(n, 3, 3)."""
    rgbs: FloatArray
    """(n, 3) in [0, 1]: the colour without its dependence on the direction."""
    opacities: FloatArray
    """(n, 1)."""

    def part(self, flags: BoolArray) -> Splats:
        """Those whose flag (n,) is set."""
        return Splats(
            self.centers[flags], self.covariances[flags], self.rgbs[flags], self.opacities[flags]
        )

    def dyed(self, rgb: tuple[float, float, float]) -> Splats:
        """All in one colour, each in [0, 1], with a little of their own to show the shape."""
        shade = self.rgbs.mean(axis=1, keepdims=True)
        colours = np.asarray(rgb, np.float32) * (0.55 + 0.45 * shade)
        return Splats(self.centers, self.covariances, colours.astype(np.float32), self.opacities)


def splats_of(gaussians: Gaussians, frame: DisplayFrame) -> Splats:
    """All Gaussians of a scene.

    Args:
        gaussians: The scene G.
        frame: How it is drawn.
    """
    axes = Rotation.from_quat(gaussians.quats, scalar_first=True).as_matrix()
    spread = axes * (gaussians.scales * np.float32(frame.factor))[:, None, :]
    return Splats(
        frame.place(gaussians.means),
        (spread @ spread.transpose(0, 2, 1)).astype(np.float32),
        np.clip(0.5 + SH_C0 * gaussians.sh[:, 0], 0, 1).astype(np.float32),
        gaussians.opacities[:, None],
    )


def frustum_lines(cameras: Sequence[Camera], depth: float, frame: DisplayFrame) -> FloatArray:
    """The pyramids that cameras look through.

    Args:
        cameras: The cameras.
        depth: Height of the pyramids, scene units.
        frame: How they are drawn.

    Returns:
        (8 k, 2, 3) ends of line segments, eight for each camera.
    """
    lines = []
    for camera in cameras:
        right, low = camera.width, camera.height
        corners = camera.unproject(
            np.array([(0, 0), (right, 0), (right, low), (0, low)], float), np.full(4, depth)
        )
        lines += [(camera.position, corner) for corner in corners]
        lines += list(zip(corners, np.roll(corners, -1, axis=0), strict=True))
    return frame.place(np.array(lines, dtype=np.float64).reshape(-1, 2, 3))
