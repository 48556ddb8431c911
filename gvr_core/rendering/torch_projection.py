"""From the world to the picture in plain torch: the projection of the slow renderer."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gvr_core.cameras import Camera
from gvr_core.gaussians import Gaussians
from gvr_core.rendering.base import LOW_PASS, NEAR


@dataclass(frozen=True, eq=False)
class Projected:
    """The n Gaussians in front of the camera, front to back."""

    index: Tensor
    """(n,) int64, their numbers in the set."""
    mean: Tensor
    """(n, 2) pixels."""
    covariance: Tensor
    """(n, 2, 2) pixels squared, low-pass added."""
    depth: Tensor
    """(n,) z in the camera frame, scene units."""
    opacity: Tensor
    """(n,)."""
    colour: Tensor
    """(n, 3)."""

    def __getitem__(self, which: Tensor | slice) -> Projected:
        return Projected(
            self.index[which],
            self.mean[which],
            self.covariance[which],
            self.depth[which],
            self.opacity[which],
            self.colour[which],
        )


def project(gaussians: Gaussians, camera: Camera, dtype: torch.dtype) -> Projected:
    """All Gaussians in front of the camera, in order of depth; ties in order of index.

    Args:
        gaussians: The set.
        camera: Where from.
        dtype: To compute in.
    """
    means, scales, quats, opacity, sh = (
        torch.tensor(np.ascontiguousarray(array), dtype=dtype)
        for array in (
            *(gaussians.means, gaussians.scales, gaussians.quats),
            *(gaussians.opacities, gaussians.sh),
        )
    )
    pose = torch.tensor(camera.world_to_camera, dtype=dtype)
    rotation, translation = pose[:3, :3], pose[:3, 3]
    local = means @ rotation.T + translation
    # Depths are told apart as float32, as by every renderer that sorts them.
    depth, order = torch.sort(local[:, 2].to(torch.float32), stable=True)
    order = order[depth >= NEAR]
    x, y, z = local[order].unbind(1)
    fx, fy, cx, cy = (float(camera.K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))

    # The Jacobian of the projection, taken within 1.3 times the field of view.
    margin_x, margin_y = 0.3 * camera.width / (2 * fx), 0.3 * camera.height / (2 * fy)
    tx = z * (x / z).clamp(-cx / fx - margin_x, (camera.width - cx) / fx + margin_x)
    ty = z * (y / z).clamp(-cy / fy - margin_y, (camera.height - cy) / fy + margin_y)
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [
            torch.stack([fx / z, zero, -fx * tx / z**2], dim=1),
            torch.stack([zero, fy / z, -fy * ty / z**2], dim=1),
        ],
        dim=1,
    )
    axes = rotation_matrices(quats[order]) * scales[order][:, None, :]
    sigma = axes @ axes.transpose(1, 2)
    to_picture = jacobian @ rotation
    covariance = to_picture @ sigma @ to_picture.transpose(1, 2)
    covariance = covariance + LOW_PASS * torch.eye(2, dtype=dtype)

    direction = means[order] - torch.tensor(camera.position, dtype=dtype)
    direction = torch.nn.functional.normalize(direction, dim=1)
    basis = spherical_harmonics(direction, gaussians.sh_degree)
    colour = (0.5 + torch.einsum("nk,nkc->nc", basis, sh[order])).clamp(min=0)
    mean = torch.stack([fx * x / z + cx, fy * y / z + cy], dim=1)
    return Projected(order, mean, covariance, z, opacity[order], colour)


def rotation_matrices(quats: Tensor) -> Tensor:
    """Rotations (n, 3, 3) of quaternions (n, 4), scalar first, normalised here."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=1).unbind(1)
    return torch.stack(
        [
            torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], dim=1),
            torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], dim=1),
            torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], dim=1),
        ],
        dim=1,
    )


def spherical_harmonics(direction: Tensor, degree: int) -> Tensor:
    """Real spherical harmonics up to a degree, with the signs of Kerbl et al. (2023).

    Args:
        direction: (n, 3) unit vectors from the camera to the means.
        degree: 0 to 3.

    Returns:
        (n, (degree + 1)^2).
    """
    x, y, z = direction.unbind(1)
    pi = math.pi
    basis = [torch.full_like(x, math.sqrt(1 / (4 * pi)))]
    if degree >= 1:
        c = math.sqrt(3 / (4 * pi))
        basis += [-c * y, c * z, -c * x]
    if degree >= 2:
        c = math.sqrt(15 / (4 * pi))
        basis += [
            c * x * y,
            -c * y * z,
            math.sqrt(5 / (16 * pi)) * (3 * z * z - 1),
            -c * x * z,
            c / 2 * (x * x - y * y),
        ]
    if degree >= 3:
        basis += [
            -math.sqrt(35 / (32 * pi)) * y * (3 * x * x - y * y),
            math.sqrt(105 / (4 * pi)) * x * y * z,
            -math.sqrt(21 / (32 * pi)) * y * (5 * z * z - 1),
            math.sqrt(7 / (16 * pi)) * z * (5 * z * z - 3),
            -math.sqrt(21 / (32 * pi)) * x * (5 * z * z - 1),
            math.sqrt(105 / (16 * pi)) * z * (x * x - y * y),
            -math.sqrt(35 / (32 * pi)) * x * (x * x - 3 * y * y),
        ]
    return torch.stack(basis, dim=1)
