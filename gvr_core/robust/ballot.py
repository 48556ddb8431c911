"""Votes of views on Gaussians: what each contributes inside and outside of a mask."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gvr_core.cameras import Camera
from gvr_core.gaussians import Gaussians
from gvr_core.rendering.base import Renderer
from gvr_core.segment import frustum_filter

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float32]
Float64Array = NDArray[np.float64]

UNSEEN = 1e-3
"""A Gaussian with less weight than this in a view, in pixels, is not seen by it."""
LEAKED = 0.05
"""Part of the typical weight below which a Gaussian only shines through a surface."""


def mask_weights(
    renderer: Renderer,
    gaussians: Gaussians,
    camera: Camera,
    mask: BoolArray,
    drawn: BoolArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """A_g and B_g: what each Gaussian contributes inside and outside of a mask.

    A_g = sum over pixels of m alpha_g T, B_g the same with 1 - m. A Gaussian behind the object
    has no transmittance left and so no say, a large one is judged by all of its footprint, and
    what is off the picture counts for nothing. Source: Shen et al., "FlashSplat" (ECCV 2024).

    Args:
        renderer: Draws the view.
        gaussians: The scene G.
        camera: The camera of the mask.
        mask: (H, W).
        drawn: (N,) flags of the Gaussians to draw; None for all.

    Returns:
        A and B, each (N,) float32, pixels; 0 for what is not drawn.
    """
    both = renderer.weights(gaussians, camera, np.stack([mask, ~mask]), drawn).toarray()
    inside, outside = both.T.copy()
    return inside, outside


def centre_weights(
    gaussians: Gaussians, camera: Camera, mask: BoolArray, drawn: BoolArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """The paper's frustum filtering in the same shape: 1 where a centre projects into the mask.

    Args:
        gaussians: The scene G.
        camera: The camera of the mask.
        mask: (H, W).
        drawn: (N,) flags of the Gaussians that are asked about; None for all.

    Returns:
        (N,) 1 for centres inside of the mask, and (N,) 1 for those in the rest of the picture.
    """
    inside = frustum_filter(gaussians, camera, mask, drawn)
    outside = frustum_filter(gaussians, camera, ~mask, drawn)
    return inside.astype(np.float32), outside.astype(np.float32)


@dataclass
class Ballot:
    """The votes of several views, added up."""

    n: int
    """N."""
    views: int = 0
    """How many views have voted."""
    inside: Float64Array = field(init=False)
    """(N,) sum of c_v A_gv."""
    outside: Float64Array = field(init=False)
    """(N,) sum of c_v B_gv."""

    def __post_init__(self) -> None:
        self.inside = np.zeros(self.n)
        self.outside = np.zeros(self.n)

    def add(self, weights: tuple[FloatArray, FloatArray], trust: float) -> None:
        """Count one view's weights.

        Args:
            weights: A and B, each (N,).
            trust: c_v, how much the view's word counts; not negative.
        """
        self.inside += trust * weights[0]
        self.outside += trust * weights[1]
        self.views += 1

    @property
    def seen(self) -> BoolArray:
        """(N,) whether the views have a say on the Gaussian.

        A surface lets a little light through, so what lies behind it has some weight left in
        every view, and always inside of the mask. That is no sight of it: a Gaussian counts as
        seen with a twentieth of the weight that the target's own Gaussians typically have.
        """
        total = self.inside + self.outside
        own = total[(total > UNSEEN) & (self.inside > self.outside)]
        return total > max(UNSEEN, LEAKED * float(np.median(own)) if len(own) else 0.0)

    @property
    def share(self) -> FloatArray:
        """(N,) s_g = sum c_v A_gv / sum c_v (A_gv + B_gv); 0 for what no view has seen."""
        total = self.inside + self.outside
        shares = np.divide(self.inside, total, out=np.zeros(self.n), where=total > UNSEEN)
        return shares.astype(np.float32)
