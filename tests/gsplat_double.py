"""Test double of gsplat 1.5: the three functions that the CUDA backend calls, in plain torch.

It follows gsplat's kernels operation by operation in float32 on the processor: their projection,
tile lists, decisions, and the backward pass, which works T out from behind and so begins with the
little that float32 keeps of 1 - alpha. It is slow, and meant for some thousand Gaussians.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor

from gvr_core.rendering.torch_projection import rotation_matrices, spherical_harmonics

ALPHA_THRESHOLD = 1 / 255
EXTENT = 3.33


@dataclass
class GsplatDouble:
    """Stands for the module ``gsplat`` where there is no GPU.

    Args:
        calls: Pictures in each call of ``rasterization``, in order.
    """

    calls: list[int]

    def rasterization(
        self,
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        opacities: Tensor,
        colors: Tensor,
        viewmats: Tensor,
        Ks: Tensor,
        width: int,
        height: int,
        near_plane: float = 0.01,
        *,
        eps2d: float = 0.3,
        sh_degree: int | None = None,
        packed: bool = True,
        tile_size: int = 16,
        backgrounds: Tensor | None = None,
        render_mode: str = "RGB",
    ) -> tuple[Tensor, Tensor, dict[str, Any]]:
        if packed or render_mode != "RGB+ED" or sh_degree is None or backgrounds is None:
            raise NotImplementedError("the double knows what the backend asks for, and no more")
        count = len(viewmats)
        self.calls.append(count)
        radii, means2d, depths, conics = project(
            means, quats, scales, opacities, viewmats, Ks, width, height, near_plane, eps2d
        )
        eye = torch.inverse(viewmats)[:, :3, 3]
        colours = torch.stack(
            [
                torch.einsum(
                    "nk,nkc->nc",
                    spherical_harmonics(
                        torch.nn.functional.normalize(means - eye[i], dim=1), sh_degree
                    ),
                    colors,
                )
                for i in range(count)
            ]
        )
        channels = torch.cat([(colours + 0.5).clamp(min=0), depths[..., None]], dim=-1)
        starts, ids = tile_lists(means2d, radii, depths, tile_size, width, height)
        spread = opacities.expand(count, -1)
        behind = torch.cat([backgrounds, torch.zeros(count, 1)], dim=1)
        drawn, alpha = self.rasterize_to_pixels(
            means2d, conics, channels, spread, width, height, tile_size, starts, ids, behind
        )
        drawn = torch.cat([drawn[..., :3], drawn[..., 3:] / alpha.clamp(min=1e-10)], dim=-1)
        # What the kernels do not write stays uninitialised: nobody may read it.
        unseen = ~(radii > 0).all(-1)
        for values in (means2d, depths, conics):
            values[unseen] = torch.nan
        meta = {
            "means2d": means2d,
            "conics": conics,
            "opacities": spread,
            "depths": depths,
            "isect_offsets": starts,
            "flatten_ids": ids,
            "width": width,
            "height": height,
        }
        return drawn, alpha, meta

    def rasterize_to_pixels(
        self,
        means2d: Tensor,
        conics: Tensor,
        colors: Tensor,
        opacities: Tensor,
        image_width: int,
        image_height: int,
        tile_size: int,
        isect_offsets: Tensor,
        flatten_ids: Tensor,
        backgrounds: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        size = (image_width, image_height, tile_size)
        behind = torch.zeros(len(means2d), colors.shape[-1]) if backgrounds is None else backgrounds
        return _Blend.apply(
            colors, means2d, conics, opacities, isect_offsets, flatten_ids, behind, size
        )

    @torch.no_grad()
    def rasterize_to_indices_in_range(
        self,
        range_start: int,
        range_end: int,
        transmittances: Tensor,
        means2d: Tensor,
        conics: Tensor,
        opacities: Tensor,
        image_width: int,
        image_height: int,
        tile_size: int,
        isect_offsets: Tensor,
        flatten_ids: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        n, block = means2d.shape[1], tile_size**2
        found = []
        for tile in tiles(
            means2d, conics, opacities, image_width, image_height, tile_size, isect_offsets,
            flatten_ids, slice(range_start * block, range_end * block),
        ):  # fmt: skip
            before = transmittances[tile.image].flatten()[tile.pixels]
            after = before[:, None] * torch.cumprod(1 - tile.alpha, dim=1)
            blended = (tile.alpha > 0) & (after > 1e-4)
            pixel, place = blended.nonzero(as_tuple=True)
            image = torch.full_like(pixel, tile.image)
            found.append(torch.stack([image, tile.pixels[pixel], tile.ids[place] % n]))
        image, pixels, ids = torch.cat([*found, torch.zeros(3, 0, dtype=torch.int64)], dim=1)
        order = torch.sort(image * image_width * image_height + pixels, stable=True).indices
        return ids[order], pixels[order], image[order]


def project(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    near: float,
    eps2d: float,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Radii (C, N, 2), means (C, N, 2), depths (C, N) and conics (C, N, 3) of C views."""
    turned = viewmats[:, :3, :3]
    local = torch.einsum("cij,nj->cni", turned, means) + viewmats[:, None, :3, 3]
    axes = rotation_matrices(quats) * scales[:, None, :]
    sigma = torch.einsum("cij,njk,clk->cnil", turned, axes @ axes.mT, turned)
    x, y, z = local.unbind(-1)
    fx, fy, cx, cy = (Ks[:, i, j, None] for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    margin_x, margin_y = 0.15 * width / fx, 0.15 * height / fy
    tx = z * torch.clamp(x / z, -(cx / fx + margin_x), (width - cx) / fx + margin_x)
    ty = z * torch.clamp(y / z, -(cy / fy + margin_y), (height - cy) / fy + margin_y)
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [fx / z, zero, -fx * tx / z**2, zero, fy / z, -fy * ty / z**2], dim=-1
    ).reshape(*z.shape, 2, 3)
    flat = jacobian @ sigma @ jacobian.mT + eps2d * torch.eye(2)
    a, b, c = flat[..., 0, 0], flat[..., 0, 1], flat[..., 1, 1]
    det = a * c - b * b
    conics = torch.stack([c / det, -b / det, a / det], dim=-1)
    means2d = torch.stack([fx * x / z + cx, fy * y / z + cy], dim=-1)
    extent = torch.sqrt(2 * torch.log(opacities / ALPHA_THRESHOLD)).clamp(max=EXTENT)
    radii = torch.ceil(extent[:, None] * torch.stack([a.sqrt(), c.sqrt()], dim=-1))
    seen = (z >= near) & (det > 0) & (opacities >= ALPHA_THRESHOLD)
    seen &= ((means2d + radii > 0) & (means2d - radii < torch.tensor([width, height]))).all(-1)
    return torch.where(seen[..., None], radii, 0).int(), means2d, z.clone(), conics


def tile_lists(
    means2d: Tensor, radii: Tensor, depths: Tensor, tile: int, width: int, height: int
) -> tuple[Tensor, Tensor]:
    """Where each tile's list begins (C, rows, columns), and the lists, front to back."""
    count, n = depths.shape
    rows, columns = -(-height // tile), -(-width // tile)
    most = torch.tensor([columns, rows])
    low = torch.floor((means2d - radii) / tile).clamp(min=0).minimum(most).nan_to_num().int()
    high = torch.ceil((means2d + radii) / tile).clamp(min=0).minimum(most).nan_to_num().int()
    seen = (radii > 0).all(-1)
    starts, ids, total = torch.zeros(count, rows, columns, dtype=torch.int32), [], 0
    for image in range(count):
        # gsplat sorts by the bits of a float32, and keeps the order of equal ones.
        order = torch.sort(depths[image], stable=True).indices
        for row in range(rows):
            for column in range(columns):
                here = torch.tensor([column, row])
                touches = ((low[image] <= here) & (here < high[image])).all(-1) & seen[image]
                chosen = order[touches[order]]
                starts[image, row, column] = total
                ids.append(chosen + image * n)
                total += len(chosen)
    return starts, torch.cat(ids).int()


@dataclass(frozen=True)
class Tile:
    """The pixels of one tile, and the Gaussians of its list."""

    image: int
    pixels: Tensor
    """(p,) row by row in the picture."""
    ids: Tensor
    """(n,) among those of all pictures."""
    alpha: Tensor
    """(p, n); 0 where the kernels skip the pair."""


def tiles(
    means2d: Tensor,
    conics: Tensor,
    opacities: Tensor,
    width: int,
    height: int,
    size: int,
    starts: Tensor,
    ids: Tensor,
    part: slice = slice(None),
) -> Iterator[Tile]:
    """All tiles that have Gaussians in the given part of their lists."""
    edges = [*starts.flatten().tolist(), len(ids)]
    columns = starts.shape[2]
    for number, (first, last) in enumerate(pairwise(edges)):
        chosen = ids[first:last][part].long()
        if not len(chosen):
            continue
        image, place = divmod(number, starts.shape[1] * columns)
        top, left = place // columns * size, place % columns * size
        y = torch.arange(top, min(top + size, height))
        x = torch.arange(left, min(left + size, width))
        pixels = (y[:, None] * width + x).flatten()
        mean, conic = means2d.reshape(-1, 2)[chosen], conics.reshape(-1, 3)[chosen]
        dx = mean[:, 0] - (pixels % width + 0.5)[:, None]
        dy = mean[:, 1] - (pixels // width + 0.5)[:, None]
        sigma = 0.5 * (conic[:, 0] * dx * dx + conic[:, 2] * dy * dy) + conic[:, 1] * dx * dy
        alpha = (opacities.reshape(-1)[chosen] * torch.exp(-sigma)).clamp(max=0.999)
        alpha = torch.where((sigma < 0) | (alpha < ALPHA_THRESHOLD), 0, alpha)
        yield Tile(image, pixels, chosen, alpha)


class _Blend(torch.autograd.Function):
    """Blending, with the gradient of the colours as gsplat's backward kernel makes it."""

    @staticmethod
    def forward(ctx, colours, means2d, conics, opacities, starts, ids, behind, size):
        width, height, tile = size
        drawn = behind[:, None, :].repeat(1, width * height, 1)
        alphas = torch.zeros(len(means2d), width * height)
        for part in tiles(means2d, conics, opacities, width, height, tile, starts, ids):
            weights, through = _weights(part.alpha)
            flat = colours.reshape(-1, colours.shape[-1])[part.ids]
            drawn[part.image, part.pixels] = weights @ flat + through[:, None] * behind[part.image]
            alphas[part.image, part.pixels] = 1 - through
        ctx.save_for_backward(colours, means2d, conics, opacities, starts, ids, alphas)
        ctx.size = size
        shape = len(means2d), height, width, -1
        return drawn.reshape(shape), alphas.reshape(shape)

    @staticmethod
    def backward(ctx, upstream, _):
        colours, means2d, conics, opacities, starts, ids, alphas = ctx.saved_tensors
        width, height, tile = ctx.size
        gradient = torch.zeros_like(colours).reshape(-1, colours.shape[-1])
        flat = upstream.reshape(len(means2d), width * height, -1)
        for part in tiles(means2d, conics, opacities, width, height, tile, starts, ids):
            weights, through = _weights(part.alpha)
            begun_with = 1 - alphas[part.image, part.pixels]
            weights = weights * (begun_with / through)[:, None]
            gradient.index_add_(0, part.ids, weights.T @ flat[part.image, part.pixels])
        return gradient.reshape(colours.shape), *(7 * [None])


def _weights(alpha: Tensor) -> tuple[Tensor, Tensor]:
    """alpha T of (p, n) pairs front to back, 0 from the stop on, and T behind the last."""
    after = torch.cumprod(1 - alpha, dim=1)
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], dim=1)
    blended = after > 1e-4
    through = torch.where(blended, after, 1).amin(dim=1)
    return torch.where(blended, alpha * before, 0), through
