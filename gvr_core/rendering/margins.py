"""How near each pixel of a picture comes to a decision that rounding could turn over.

Three decisions make a picture jump: whether an alpha counts (1/255), whether blending stops
(T at 1e-4) and where T crosses 0.5. Between two correct renderers of different precision a pixel
may differ by a whole decision only where it comes very near to one; everywhere else they must
agree to rounding. This module tells the two kinds of pixels apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from gvr_core.cameras import Camera
from gvr_core.gaussians import Gaussians
from gvr_core.rendering.base import ALPHA_MIN, TRANSMITTANCE_MIN
from gvr_core.rendering.torch_projection import project
from gvr_core.rendering.torch_reference import (
    alphas,
    blocks,
    counted,
    pixel_centres,
)


@dataclass(frozen=True, eq=False)
class Margins:
    """Relative distance of each pixel from its nearest decisions; inf where it meets none."""

    alpha: NDArray[np.float64]
    """(H, W) least |alpha / (1/255) - 1| of the Gaussians before the stop."""
    stop: NDArray[np.float64]
    """(H, W) least |T / 1e-4 - 1| behind the Gaussians up to the stop."""
    median: NDArray[np.float64]
    """(H, W) least |T / 0.5 - 1| behind the Gaussians up to the stop."""


def decision_margins(gaussians: Gaussians, camera: Camera) -> Margins:
    """The margins of a picture, by the float64 reference.

    Args:
        gaussians: The set drawn.
        camera: Where from.
    """
    out = torch.full((3, camera.height, camera.width), torch.inf, dtype=torch.float64)
    projected = project(gaussians, camera, torch.float64)
    for block, chunks in blocks(projected, camera):
        pixels = pixel_centres(block, torch.float64)
        product = torch.ones_like(pixels[:, 0])
        for chunk in chunks:
            alpha = alphas(chunk, pixels)
            after = product[:, None] * torch.cumprod(1 - counted(alpha), dim=1)
            before = torch.cat([product[:, None], after[:, :-1]], dim=1)
            product, reached = after[:, -1], before > TRANSMITTANCE_MIN
            for n, values in enumerate((alpha / ALPHA_MIN, after / TRANSMITTANCE_MIN, after / 0.5)):
                nearest = torch.where(reached, (values - 1).abs(), torch.inf).amin(dim=1)
                part = out[n][block]
                part.copy_(torch.minimum(part, nearest.reshape(part.shape)))
            if product.max() <= TRANSMITTANCE_MIN:
                break
    return Margins(*out.numpy())
