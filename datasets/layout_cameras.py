"""The cameras of a layout, and the similarity that moves its whole world."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat
from scipy.spatial.transform import Rotation

from datasets.layout_tables import Direction, Positive, Table, Vector
from datasets.making import orbit_camera
from gvr_core.cameras import Camera, unit
from gvr_core.gaussians import Gaussians
from gvr_core.transforms import transform_gaussians


class OrbitTable(Table):
    """``[[cameras.knowledge]]`` and ``[[cameras.test]]``: cameras on an arc around the target."""

    count: Annotated[int, Field(ge=1, le=1000)]
    radius: Positive
    """Distance from the target, scene units."""
    yaw: tuple[FiniteFloat, FiniteFloat]
    """From, and up to but without, degrees; 0 is in front (-y), 90 to the right (+x)."""
    pitch: tuple[FiniteFloat, FiniteFloat]
    """Lowest and highest angle above the ground, degrees."""

    def poses(self) -> list[tuple[float, float]]:
        """Yaw and pitch of each camera, degrees: yaw in even steps, pitch spread over its range."""
        yaws = np.linspace(*self.yaw, self.count, endpoint=False)
        # the golden ratio's multiples fill the range evenly for any count
        low, high = self.pitch
        pitches = low + (high - low) * ((np.arange(self.count) + 0.5) * 0.6180339887 % 1)
        return list(zip(yaws.tolist(), pitches.tolist(), strict=True))


class CamerasTable(Table):
    """``[cameras]``."""

    resolution: tuple[Annotated[int, Field(ge=16, le=8192)], Annotated[int, Field(ge=16, le=8192)]]
    """Width and height, pixels."""
    fov: Annotated[float, Field(gt=1, lt=170)]
    """Horizontal field of view, degrees."""
    target: Vector
    """What all cameras look at, scene units."""
    knowledge: Annotated[tuple[OrbitTable, ...], Field(min_length=1)]
    test: Annotated[tuple[OrbitTable, ...], Field(min_length=1)]

    def cameras(self) -> dict[str, Camera]:
        """All cameras by view name: ``view_000``... and ``test_0``..."""
        found = {}
        for kind, digits, orbits in (("view", 3, self.knowledge), ("test", 1, self.test)):
            poses = [(orbit.radius, *pose) for orbit in orbits for pose in orbit.poses()]
            for i, (radius, yaw, pitch) in enumerate(poses):
                found[f"{kind}_{i:0{digits}d}"] = orbit_camera(
                    self.target, radius, yaw, pitch, self.resolution, self.fov
                )
        return found


class WorldTable(Table):
    """``[world]``: the finished scene turned, then scaled, then moved, and its cameras with it.

    x' = scale * R x + offset. Every picture stays as it is.
    """

    axis: Direction = (0.0, 0.0, 1.0)
    """What the world is turned about, through the origin."""
    degrees: FiniteFloat = 0.0
    """Angle of the turn, right-handed about the axis."""
    scale: Positive = 1.0
    """Factor on all lengths."""
    offset: Vector = (0.0, 0.0, 0.0)
    """Where the origin goes, in the units after scaling."""

    @property
    def rotation(self) -> NDArray[np.float64]:
        """(3, 3) R."""
        turn = Rotation.from_rotvec(np.radians(self.degrees) * unit(self.axis))
        return np.asarray(turn.as_matrix(), np.float64)

    def move(self, gaussians: Gaussians) -> Gaussians:
        """The Gaussians where the world takes them."""
        return transform_gaussians(gaussians, self.rotation, self.offset, self.scale)

    def move_camera(self, camera: Camera) -> Camera:
        """The camera that sees the moved scene as this one sees the scene.

        A point's coordinates in the camera frame become ``scale`` times as large, which no pixel
        shows: R_c' = R_c R^T, t_c' = scale * t_c - R_c' offset.
        """
        matrix = np.eye(4)
        matrix[:3, :3] = camera.world_to_camera[:3, :3] @ self.rotation.T
        matrix[:3, 3] = self.scale * camera.world_to_camera[:3, 3] - matrix[:3, :3] @ self.offset
        return Camera(camera.K, matrix, camera.width, camera.height)
