"""Pinhole cameras, and the virtual cameras of the method: bird's eye and ring.

Conventions: world-to-camera matrices; OpenCV axes in the camera frame (x right, y down, z
forward); depth is z; the centre of the top left pixel is at (0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gvr_core.errors import CameraFormatError

Float64Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera without distortion.

    Raises:
        CameraFormatError: a size below one pixel, a focal length that is not positive, a number
            that is not finite, or a rotation that is none.
    """

    K: Float64Array
    """(3, 3) intrinsics in pixels: fx, fy, cx, cy; no skew."""
    world_to_camera: Float64Array
    """(4, 4) rigid transform from the world frame to the camera frame."""
    width: int
    """Picture width in pixels."""
    height: int
    """Picture height in pixels."""

    def __post_init__(self) -> None:
        if self.K.shape != (3, 3) or self.world_to_camera.shape != (4, 4):
            raise CameraFormatError(
                f"K is {self.K.shape}, world_to_camera is {self.world_to_camera.shape}",
                accepted="(3, 3) and (4, 4)",
            )
        if not (np.isfinite(self.K).all() and np.isfinite(self.world_to_camera).all()):
            raise CameraFormatError("a camera holds a number that is not finite")
        if self.width < 1 or self.height < 1:
            raise CameraFormatError(
                f"picture size {self.width} x {self.height}", accepted="at least 1 x 1 pixel"
            )
        if self.K[0, 0] <= 0 or self.K[1, 1] <= 0:
            raise CameraFormatError(
                f"focal lengths {self.K[0, 0]}, {self.K[1, 1]}", accepted="positive numbers"
            )
        rotation = self.world_to_camera[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) or (
            np.linalg.det(rotation) < 0
        ):
            raise CameraFormatError("the rotation is not orthonormal", accepted="a rigid transform")

    @cached_property
    def position(self) -> Float64Array:
        """(3,) centre of projection, world frame."""
        centre: Float64Array = -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]
        return centre

    @property
    def forward(self) -> Float64Array:
        """(3,) unit viewing direction, world frame."""
        axis: Float64Array = self.world_to_camera[2, :3]
        return axis

    def to_camera(self, points: ArrayLike) -> Float64Array:
        """World points in the camera frame.

        Args:
            points: (..., 3), world frame.

        Returns:
            (..., 3), camera frame, scene units; the last component is the depth z.
        """
        world = np.asarray(points, dtype=np.float64)
        moved: Float64Array = world @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        return moved

    def project(self, points: ArrayLike) -> tuple[Float64Array, Float64Array]:
        """World points to pixels.

        Args:
            points: (..., 3), world frame.

        Returns:
            Pixel coordinates (..., 2) as (x, y), and depths z (...). Points with z <= 0 are
            behind the camera: their pixels are NaN.
        """
        local = self.to_camera(points)
        z = local[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            flat = local[..., :2] / z[..., None]
        pixels = flat * np.array([self.K[0, 0], self.K[1, 1]]) + self.K[:2, 2]
        pixels[z <= 0] = np.nan
        return pixels, z

    def unproject(self, pixels: ArrayLike, depth: ArrayLike) -> Float64Array:
        """Pixels with depth back to the world (the paper's back-projection).

        Args:
            pixels: (..., 2) as (x, y).
            depth: (...) z-depths, scene units.

        Returns:
            (..., 3) points, world frame.
        """
        xy = np.asarray(pixels, dtype=np.float64)
        z = np.asarray(depth, dtype=np.float64)[..., None]
        rays = (xy - self.K[:2, 2]) / np.array([self.K[0, 0], self.K[1, 1]])
        local = np.concatenate([rays * z, z], axis=-1)
        world: Float64Array = (local - self.world_to_camera[:3, 3]) @ self.world_to_camera[:3, :3]
        return world

    def resized(self, width: int, height: int) -> Camera:
        """The same camera with another number of pixels."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return Camera(scale @ self.K, self.world_to_camera, width, height)


def unproject_each(
    cameras: Sequence[Camera], pixels: Float64Array, depths: Float64Array
) -> Float64Array:
    """One pixel of each of some cameras back to the world.

    Args:
        cameras: v cameras.
        pixels: (v, 2) as (x, y), one for each.
        depths: (v,) z-depths, scene units.

    Returns:
        (v, 3) points, world frame.
    """
    if len(cameras) == 0:
        return np.empty((0, 3))
    K = np.stack([camera.K for camera in cameras])
    poses = np.stack([camera.world_to_camera for camera in cameras])
    rays = (pixels - K[:, :2, 2]) / K[:, (0, 1), (0, 1)]
    local = np.column_stack([rays * depths[:, None], depths]) - poses[:, :3, 3]
    points: Float64Array = np.einsum("vi,vij->vj", local, poses[:, :3, :3])
    return points


def intrinsics(fov_x_degrees: float, width: int, height: int) -> Float64Array:
    """(3, 3) intrinsics with square pixels and the principal point in the middle.

    Args:
        fov_x_degrees: Horizontal field of view, degrees.
        width: Picture width, pixels.
        height: Picture height, pixels.
    """
    f = 0.5 * width / np.tan(np.radians(fov_x_degrees) / 2)
    return np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]], dtype=np.float64)


def look_at(position: ArrayLike, target: ArrayLike, up: ArrayLike) -> Float64Array:
    """World-to-camera matrix of a camera that looks at a point.

    Args:
        position: (3,) camera centre, world frame.
        target: (3,) point in the middle of the picture.
        up: (3,) world direction that shall point up in the picture. Where it is parallel to
            the viewing direction (bird's eye), any perpendicular direction stands in.

    Returns:
        (4, 4) float64.

    Raises:
        CameraFormatError: if position and target are the same point.
    """
    eye, goal = np.asarray(position, np.float64), np.asarray(target, np.float64)
    forward = goal - eye
    length = float(np.linalg.norm(forward))
    if length == 0 or not np.isfinite(length):
        raise CameraFormatError(f"a camera at {eye} cannot look at {goal}")
    forward = forward / length
    down = -unit(up)
    down = down - forward * (down @ forward)
    if np.linalg.norm(down) < 1e-6:
        down = any_perpendicular(forward)
    down = unit(down)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([np.cross(down, forward), down, forward])
    matrix[:3, 3] = -matrix[:3, :3] @ eye
    return matrix


def birds_eye_camera(
    location: ArrayLike, up: ArrayLike, height: float, K: Float64Array, width: int, height_px: int
) -> Camera:
    """c_BEV: the bird's-eye camera, straight above a location, looking down.

    Args:
        location: (3,) L_3D, world frame; falls on the principal point.
        up: (3,) up direction of the scene.
        height: Distance above the location, scene units.
        K: (3, 3) intrinsics.
        width: Picture width, pixels.
        height_px: Picture height, pixels.
    """
    centre = np.asarray(location, np.float64)
    eye = centre + height * unit(up)
    return Camera(K, look_at(eye, centre, up), width, height_px)


def ring_cameras(
    location: ArrayLike,
    up: ArrayLike,
    distance: float,
    pitch_degrees: float,
    k: int,
    K: Float64Array,
    width: int,
    height_px: int,
) -> list[Camera]:
    """The k surrounding cameras of the paper: uniform yaw, one pitch, looking at the location.

    Args:
        location: (3,) L_3D, world frame.
        up: (3,) up direction of the scene.
        distance: d_vir, scene units.
        pitch_degrees: Angle above the horizontal plane through the location.
        k: Number of cameras.
        K: (3, 3) intrinsics.
        width: Picture width, pixels.
        height_px: Picture height, pixels.
    """
    centre, axis = np.asarray(location, np.float64), unit(up)
    first = any_perpendicular(axis)
    second = np.cross(axis, first)
    pitch = np.radians(pitch_degrees)
    cameras = []
    for yaw in 2 * np.pi * np.arange(k) / k:
        level = np.cos(yaw) * first + np.sin(yaw) * second
        eye = centre + distance * (np.cos(pitch) * level + np.sin(pitch) * axis)
        cameras.append(Camera(K, look_at(eye, centre, axis), width, height_px))
    return cameras


@dataclass(frozen=True)
class UpVector:
    """The up direction of a scene, and how much its cameras disagree about it."""

    direction: Float64Array
    """(3,) unit vector, world frame."""
    dispersion_degrees: float
    """Mean angle between the cameras' own up axes and the direction."""


def up_vector(cameras: Sequence[Camera]) -> UpVector:
    """u: the mean of the cameras' up axes (-y in OpenCV axes).

    The paper does not define u. Photographers hold cameras level, so the mean of the up axes is
    the usual estimate (nerfstudio's ``auto_orient_and_center_poses(method="up")``).

    Raises:
        CameraFormatError: if there is no camera, or their up axes cancel out.
    """
    if not cameras:
        raise CameraFormatError("no camera to take the up direction from")
    axes = np.stack([-camera.world_to_camera[1, :3] for camera in cameras])
    mean = axes.mean(axis=0)
    if np.linalg.norm(mean) < 1e-3:
        raise CameraFormatError(
            "the cameras' up axes cancel out", accepted="cameras that agree roughly on up"
        )
    direction = unit(mean)
    angles = np.degrees(np.arccos(np.clip(axes @ direction, -1, 1)))
    return UpVector(direction, float(angles.mean()))


def unit(vector: ArrayLike) -> Float64Array:
    """A vector (3,) scaled to length 1.

    Raises:
        CameraFormatError: if it has no direction.
    """
    v = np.asarray(vector, dtype=np.float64)
    length = float(np.linalg.norm(v))
    if not np.isfinite(length) or length == 0:
        raise CameraFormatError(f"{v} has no direction", accepted="a vector of positive length")
    return v / length


def any_perpendicular(axis: Float64Array) -> Float64Array:
    """A unit vector perpendicular to a unit vector: always the same one for the same axis."""
    basis = np.eye(3)[int(np.argmin(np.abs(axis)))]
    return unit(basis - axis * (basis @ axis))
