"""The slow, obvious renderer: the formulas of the papers in plain torch, float64.

It is the oracle of the tests and the yardstick of the benchmark. It shares the constants of
``base`` with the CPU renderer and nothing else. Sources: EWA splatting (Zwicker et al., 2001),
3D Gaussian Splatting (Kerbl et al., 2023, equations 2, 3 and 5), gsplat's conventions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gvr_core.cameras import Camera
from gvr_core.gaussians import Gaussians
from gvr_core.rendering.base import (
    ALPHA_MAX,
    ALPHA_MIN,
    LOW_PASS,
    NEAR,
    TRANSMITTANCE_MIN,
    Rendering,
)
from gvr_core.rendering.inputs import checked_background, checked_mask

FloatArray = NDArray[np.float32]

_BLOCK = 16
"""Side of a block of pixels, which are blended together."""
_CHUNK = 512
"""Gaussians blended at once; bounds the memory."""
_REACH = math.sqrt(2 * math.log(1 / ALPHA_MIN))
"""Standard deviations beyond which alpha is below 1/255, whatever the opacity."""


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


@dataclass(frozen=True, eq=False)
class Blended:
    """Some pixels after some Gaussians."""

    rgb: Tensor
    """(p, 3) colour without the background."""
    transmittance: Tensor
    """(p,) T behind the last Gaussian drawn."""
    product: Tensor
    """(p,) product of 1 - alpha over all Gaussians met, those after the stop included."""
    depth_sum: Tensor
    """(p,) sum(w z)."""
    median_depth: Tensor
    """(p,) z at which T crosses 0.5, else 0."""

    @classmethod
    def nothing(cls, pixels: Tensor) -> Blended:
        """Pixels (p, 2) before the first Gaussian."""
        one, zero = torch.ones_like(pixels[:, 0]), torch.zeros_like(pixels[:, 0])
        return cls(torch.stack([zero, zero, zero], dim=1), one, one, zero, zero)


class TorchReference:
    """Draws Gaussians slowly and plainly.

    Args:
        dtype: ``torch.float64`` for an oracle; ``torch.float32`` to time it like for like.
    """

    def __init__(self, dtype: torch.dtype = torch.float64) -> None:
        self.dtype = dtype

    @property
    def name(self) -> str:
        """Name and version of the backend."""
        return f"torch-reference/1/{str(self.dtype).removeprefix('torch.')}"

    def render(
        self,
        gaussians: Gaussians,
        camera: Camera,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        mask: FloatArray | None = None,
    ) -> Rendering:
        """Draw one picture; see :class:`gvr_core.rendering.base.Renderer`.

        Raises:
            InputError: for a background or a mask that does not fit.
        """
        behind = torch.from_numpy(checked_background(background)).to(self.dtype)
        portion = None
        if mask is not None:
            portion = torch.from_numpy(checked_mask(mask, camera)).to(self.dtype)
        picture = torch.zeros(camera.height, camera.width, 6, dtype=self.dtype)
        sums = torch.zeros(2, len(gaussians), dtype=self.dtype)
        projected = self.project(gaussians, camera)
        for block, chunks in blocks(projected, camera):
            pixels = pixel_centres(block, self.dtype)
            done = Blended.nothing(pixels)
            for chunk in chunks:
                done, weights = blend(done, chunk, alphas(chunk, pixels))
                if portion is not None:
                    inside = portion[block].reshape(-1, 1)
                    sums[0].index_add_(0, chunk.index, (weights * inside).sum(0))
                    sums[1].index_add_(0, chunk.index, (weights * (1 - inside)).sum(0))
                if done.product.max() <= TRANSMITTANCE_MIN:
                    break
            alpha = 1 - done.transmittance
            depth = torch.where(alpha > 0, done.depth_sum / alpha, 0)
            rgb = done.rgb + done.transmittance[:, None] * behind
            values = torch.column_stack([rgb, alpha, depth, done.median_depth])
            picture[block] = values.reshape(*picture[block].shape)
        out = picture.to(torch.float32).numpy()
        weights_out = sums.to(torch.float32).numpy()
        return Rendering(
            rgb=np.ascontiguousarray(out[..., :3]),
            alpha=np.ascontiguousarray(out[..., 3]),
            expected_depth=np.ascontiguousarray(out[..., 4]),
            median_depth=np.ascontiguousarray(out[..., 5]),
            weight_inside=None if portion is None else weights_out[0],
            weight_outside=None if portion is None else weights_out[1],
        )

    def project(self, gaussians: Gaussians, camera: Camera) -> Projected:
        """All Gaussians in front of the camera, in order of depth; ties in order of index."""
        means, scales, quats, opacity, sh = (
            torch.from_numpy(array).to(self.dtype)
            for array in (
                gaussians.means,
                gaussians.scales,
                gaussians.quats,
                gaussians.opacities,
                gaussians.sh,
            )
        )
        pose = torch.from_numpy(camera.world_to_camera).to(self.dtype)
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
        covariance = covariance + LOW_PASS * torch.eye(2, dtype=self.dtype)

        direction = means[order] - torch.from_numpy(camera.position).to(self.dtype)
        direction = torch.nn.functional.normalize(direction, dim=1)
        basis = spherical_harmonics(direction, gaussians.sh_degree)
        colour = (0.5 + torch.einsum("nk,nkc->nc", basis, sh[order])).clamp(min=0)
        mean = torch.stack([fx * x / z + cx, fy * y / z + cy], dim=1)
        return Projected(order, mean, covariance, z, opacity[order], colour)


Block = tuple[slice, slice]
"""Rows and columns of some pixels."""


def blocks(projected: Projected, camera: Camera) -> Iterator[tuple[Block, Iterator[Projected]]]:
    """Blocks of pixels, each with the Gaussians that may be seen in it, front to back, in chunks.

    Only Gaussians further off than the distance at which any alpha is below 1/255 are left out.
    """

    def near(some: Projected, axis: int, pixels: slice) -> Projected:
        reach = _REACH * some.covariance[:, axis, axis].sqrt()
        low, high = some.mean[:, axis] - reach, some.mean[:, axis] + reach
        return some[((high >= pixels.start) & (low <= pixels.stop)).nonzero()[:, 0]]

    for top in range(0, camera.height, _BLOCK):
        rows = slice(top, min(top + _BLOCK, camera.height))
        band = near(projected, 1, rows)
        for left in range(0, camera.width, _BLOCK):
            columns = slice(left, min(left + _BLOCK, camera.width))
            seen = near(band, 0, columns)
            starts = range(0, seen.index.numel(), _CHUNK)
            yield (rows, columns), (seen[slice(n, n + _CHUNK)] for n in starts)


def pixel_centres(block: Block, dtype: torch.dtype) -> Tensor:
    """Centres (p, 2) as (x, y) of a block of pixels (rows, columns), row by row."""
    y = torch.arange(block[0].start, block[0].stop, dtype=dtype) + 0.5
    x = torch.arange(block[1].start, block[1].stop, dtype=dtype) + 0.5
    return torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1).reshape(-1, 2)


def alphas(projected: Projected, pixels: Tensor) -> Tensor:
    """Opacity of each Gaussian in each pixel (Kerbl et al., equation 2), neither cut nor clamped.

    Args:
        projected: n Gaussians.
        pixels: (p, 2) pixel centres.

    Returns:
        (p, n).
    """
    a, b = projected.covariance[:, 0, 0], projected.covariance[:, 0, 1]
    c = projected.covariance[:, 1, 1]
    det = a * c - b * b
    dx, dy = (pixels[:, None, :] - projected.mean).unbind(2)
    distance = (c / det) * dx * dx - (2 * b / det) * dx * dy + (a / det) * dy * dy
    return projected.opacity * torch.exp(-0.5 * distance)


def counted(alpha: Tensor) -> Tensor:
    """Alphas as they are blended: none below 1/255, none above 0.999."""
    return torch.where(alpha < ALPHA_MIN, 0, alpha.clamp(max=ALPHA_MAX))


def blend(done: Blended, projected: Projected, alpha: Tensor) -> tuple[Blended, Tensor]:
    """Blend more Gaussians behind those already drawn (Kerbl et al., equation 3).

    Args:
        done: p pixels so far.
        projected: n Gaussians, front to back.
        alpha: (p, n) of :func:`alphas`.

    Returns:
        The pixels after them, and the weights alpha T (p, n).
    """
    alpha = counted(alpha)
    after = done.product[:, None] * torch.cumprod(1 - alpha, dim=1)
    before = torch.cat([done.product[:, None], after[:, :-1]], dim=1)
    # T never rises, so that the first Gaussian that would take it to the limit ends the blending.
    drawn = after > TRANSMITTANCE_MIN
    weights = torch.where(drawn, alpha * before, 0)
    crosses = drawn & (before > 0.5) & (after <= 0.5)
    return (
        Blended(
            rgb=done.rgb + weights @ projected.colour,
            transmittance=done.transmittance - weights.sum(1),
            product=after[:, -1],
            depth_sum=done.depth_sum + weights @ projected.depth,
            median_depth=done.median_depth + crosses.to(alpha.dtype) @ projected.depth,
        ),
        weights,
    )


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
