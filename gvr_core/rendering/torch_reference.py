"""The slow, obvious renderer: the formulas of the papers in plain torch, float64.

It is the oracle of the tests and the yardstick of the benchmark. It shares the constants of
``base`` with the CPU renderer and nothing else. Sources: EWA splatting (Zwicker et al., 2001),
3D Gaussian Splatting (Kerbl et al., 2023), gsplat's conventions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import sparse
from torch import Tensor

from gvr_core.cameras import Camera
from gvr_core.gaussians import Gaussians
from gvr_core.rendering.base import (
    ALPHA_MAX,
    ALPHA_MIN,
    TRANSMITTANCE_MIN,
    Rendering,
    one_by_one,
)
from gvr_core.rendering.inputs import (
    checked_background,
    checked_mask,
    checked_masks,
    checked_shown,
)
from gvr_core.rendering.torch_projection import Projected, project

FloatArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]

_BLOCK = 16
"""Side of a block of pixels, which are blended together."""
_CHUNK = 512
"""Gaussians blended at once; bounds the memory."""
_REACH = math.sqrt(2 * math.log(1 / ALPHA_MIN))
"""Standard deviations beyond which alpha is below 1/255, whatever the opacity."""


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

    @torch.inference_mode()
    def render(
        self,
        gaussians: Gaussians,
        camera: Camera,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        mask: FloatArray | None = None,
        shown: BoolArray | None = None,
    ) -> Rendering:
        """Draw one picture; see :class:`gvr_core.rendering.base.Renderer`.

        Raises:
            InputError: for a background, a mask or flags that do not fit.
        """
        behind = torch.tensor(checked_background(background), dtype=self.dtype)
        portion = None
        if mask is not None:
            portion = torch.tensor(checked_mask(mask, camera), dtype=self.dtype)
        picture = torch.zeros(camera.height, camera.width, 6, dtype=self.dtype)
        sums = torch.zeros(2, len(gaussians), dtype=self.dtype)
        projected = self._project(gaussians, camera, shown)
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

    def render_many(
        self,
        gaussians: Gaussians,
        cameras: Sequence[Camera],
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        shown: BoolArray | None = None,
    ) -> Iterator[Rendering]:
        """Draw one picture after the other; see :class:`gvr_core.rendering.base.Renderer`."""
        return one_by_one(self, gaussians, cameras, background, shown)

    @torch.inference_mode()
    def weights(
        self,
        gaussians: Gaussians,
        camera: Camera,
        masks: BoolArray,
        shown: BoolArray | None = None,
    ) -> sparse.csr_array:
        """Weights under masks; see :class:`gvr_core.rendering.base.Renderer`.

        Raises:
            InputError: for masks or flags that do not fit.
        """
        portions = torch.tensor(checked_masks(masks, camera), dtype=self.dtype)
        sums = torch.zeros(len(gaussians), len(masks), dtype=self.dtype)
        for block, chunks in blocks(self._project(gaussians, camera, shown), camera):
            inside = portions[:, block[0], block[1]].reshape(len(masks), -1)
            done = Blended.nothing(pixel_centres(block, self.dtype))
            for chunk in chunks:
                done, weights = blend(done, chunk, alphas(chunk, pixel_centres(block, self.dtype)))
                sums.index_add_(0, chunk.index, (inside @ weights).T)
                if done.product.max() <= TRANSMITTANCE_MIN:
                    break
        return sparse.csr_array(sums.to(torch.float32).numpy())

    def _project(self, gaussians: Gaussians, camera: Camera, shown: BoolArray | None) -> Projected:
        projected = project(gaussians, camera, self.dtype)
        flags = torch.tensor(checked_shown(shown, len(gaussians)))
        return projected[flags[projected.index].nonzero()[:, 0]]


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
