"""One view of gsplat's projection, and what is derived from it: median depth, sums of weights.

gsplat has neither for 3D Gaussians. Both are made from its own projected Gaussians and sorted tile
lists, so that they belong to the very picture that it drew.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from gvr_core.rendering.base import ALPHA_MAX
from gvr_core.rendering.gsplat_functions import BLOCK, TILE, GsplatFunctions

CHANNELS = 32
"""Most channels that are rendered at once: more are slower than twice as many calls."""


@dataclass(frozen=True, eq=False)
class ProjectedView:
    """The N Gaussians as one view sees them; numbers of those that it does not see mean nothing."""

    means2d: Tensor
    """(1, N, 2) float32 pixels."""
    conics: Tensor
    """(1, N, 3) float32: xx, xy, yy of the inverse covariance, 1/pixel^2."""
    opacities: Tensor
    """(1, N) float32."""
    depths: Tensor
    """(N,) float32 z, scene units."""
    tile_starts: Tensor
    """(1, rows, columns) int32: where each tile's part of ``ids`` begins."""
    ids: Tensor
    """(P,) int32 Gaussians of the tiles, one tile after the other, each front to back."""
    width: int
    height: int


def views_of(meta: dict[str, Any]) -> list[ProjectedView]:
    """The views of a call of ``rasterization``, which are drawn as one but looked at one by one.

    Args:
        meta: What ``rasterization`` returns third, for C views, unpacked.
    """
    count, n = meta["means2d"].shape[:2]
    starts = meta["isect_offsets"].reshape(count, -1)
    edges = [*starts[:, 0].tolist(), len(meta["flatten_ids"])]
    return [
        ProjectedView(
            means2d=meta["means2d"][i : i + 1].contiguous(),
            conics=meta["conics"][i : i + 1].contiguous(),
            opacities=meta["opacities"][i : i + 1].contiguous(),
            depths=meta["depths"][i],
            tile_starts=(meta["isect_offsets"][i : i + 1] - edges[i]).contiguous(),
            ids=(meta["flatten_ids"][edges[i] : edges[i + 1]] - i * n).contiguous(),
            width=int(meta["width"]),
            height=int(meta["height"]),
        )
        for i in range(count)
    ]


@torch.no_grad()
def median_depth(api: GsplatFunctions, view: ProjectedView) -> Tensor:
    """Depth of the Gaussian at which the transmittance T crosses 0.5.

    gsplat names the Gaussians that it blends in each pixel, front to back, a block of a tile's list
    at a time. Here their opacities are multiplied up to T, in double; the Gaussian that takes T
    from above 0.5 to 0.5 or below gives the depth. A pixel that has its depth is handed back to
    gsplat with T = 0, so that it names no more for it.

    Args:
        api: gsplat.
        view: The view.

    Returns:
        (H, W) float32, scene units; 0 where T never crosses 0.5.
    """
    device = view.means2d.device
    through = torch.ones(view.height * view.width, dtype=torch.float64, device=device)
    depth = torch.zeros(view.height * view.width, dtype=torch.float32, device=device)
    for block in range(-(-_longest_list(view) // BLOCK)):
        if not bool((through > 0).any()):
            break
        ids, pixels, _ = api.rasterize_to_indices_in_range(
            block,
            block + 1,
            through.to(torch.float32).reshape(1, view.height, view.width),
            view.means2d,
            view.conics,
            view.opacities,
            view.width,
            view.height,
            TILE,
            view.tile_starts,
            view.ids,
        )
        if ids.numel() == 0:
            continue
        before, after, last = _transmittances(_alphas(view, ids, pixels), pixels, through)
        crosses = (before > 0.5) & (after <= 0.5)
        depth[pixels[crosses]] = view.depths[ids[crosses]]
        through[pixels[last]] = torch.where(after[last] > 0.5, after[last], 0)
    return depth.reshape(view.height, view.width)


def weight_sums(api: GsplatFunctions, view: ProjectedView, masks: Tensor) -> Tensor:
    """Sums over pixels of mask * alpha_g T, of each mask and Gaussian.

    A channel c is drawn as out = sum_g c_g alpha_g T, so that d/dc_g sum_pixels(mask * out) is the
    sum wanted: gsplat's backward pass gives it for all Gaussians at once, with a channel a mask.

    That pass works T out from behind, beginning with 1 - alpha of the picture, of which float32
    keeps three digits where the picture is opaque. The channels are drawn with colour 0 over
    a background of 1, which gives that T to all digits, and the mask is scaled by the ratio.

    Args:
        api: gsplat.
        view: The view.
        masks: (M, H, W) float32 in [0, 1].

    Returns:
        (M, N) float32. gsplat adds with atomics: the last digits differ from call to call.
    """
    n = view.means2d.shape[1]
    sums = torch.zeros(len(masks), n, dtype=torch.float32, device=masks.device)
    if view.ids.numel() == 0:
        return sums
    for first in range(0, len(masks), CHANNELS):
        part = masks[first : first + CHANNELS]
        with torch.enable_grad():
            colours = torch.zeros(1, n, len(part), device=masks.device, requires_grad=True)
            drawn, alpha = api.rasterize_to_pixels(
                view.means2d,
                view.conics,
                colours,
                view.opacities,
                view.width,
                view.height,
                TILE,
                view.tile_starts,
                view.ids,
                backgrounds=torch.ones(1, len(part), device=masks.device),
            )
        correction = drawn[..., :1].detach() / (1 - alpha.detach())
        wanted = part.permute(1, 2, 0)[None] * correction
        (gradient,) = torch.autograd.grad(drawn, colours, wanted)
        sums[first : first + CHANNELS] = gradient[0].T
    return sums


def _longest_list(view: ProjectedView) -> int:
    starts = view.tile_starts.flatten()
    ends = torch.cat([starts[1:], starts.new_tensor([len(view.ids)])])
    return int((ends - starts).max())


def _alphas(view: ProjectedView, ids: Tensor, pixels: Tensor) -> Tensor:
    """(m,) float64 opacities of pairs of Gaussian and pixel, none of which is below 1/255."""
    x, y = pixels % view.width + 0.5, pixels // view.width + 0.5
    dx, dy = view.means2d[0, ids, 0] - x, view.means2d[0, ids, 1] - y
    xx, xy, yy = view.conics[0, ids].unbind(1)
    sigma = 0.5 * (xx * dx * dx + yy * dy * dy) + xy * dx * dy
    alpha = view.opacities[0, ids] * torch.exp(-sigma)
    return alpha.clamp(max=ALPHA_MAX).to(torch.float64)


def _transmittances(
    alpha: Tensor, pixels: Tensor, through: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """T before and after each pair, and which pairs are the last of their pixel.

    Args:
        alpha: (m,) float64, of pairs that stand together pixel by pixel, front to back.
        pixels: (m,) int64.
        through: (H W,) float64, T in front of the first pair.
    """
    changes = pixels[1:] != pixels[:-1]
    edge = changes.new_ones(1)
    first, last = torch.cat([edge, changes]), torch.cat([changes, edge])
    logs = torch.log1p(-alpha)
    sums = logs.cumsum(0)
    places = torch.arange(len(pixels), device=pixels.device)
    start = torch.where(first, places, 0).cummax(0).values
    since = sums - (sums - logs)[start]
    after = through[pixels] * torch.exp(since)
    before = torch.where(first, through[pixels], after.roll(1))
    return before, after, last
