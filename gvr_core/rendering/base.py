"""What every renderer takes and gives.

Conventions (those of gsplat): activated scales and opacities, wxyz quaternions, world-to-camera
matrices, OpenCV camera axes, depth is z. A low-pass of 0.3 px is added to the projected
covariance; a Gaussian's alpha in a pixel is skipped below 1/255 and clamped at 0.999; blending
stops before the transmittance T falls to 1e-4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gvr_core.cameras import Camera
from gvr_core.errors import unknown_name
from gvr_core.gaussians import Gaussians

FloatArray = NDArray[np.float32]

LOW_PASS = 0.3
"""Added to the diagonal of the projected covariance, pixels squared."""
ALPHA_MIN = 1.0 / 255.0
"""A Gaussian's alpha in a pixel below this is skipped."""
ALPHA_MAX = 0.999
"""A Gaussian's alpha in a pixel is clamped to this."""
TRANSMITTANCE_MIN = 1e-4
"""Blending stops before the transmittance falls to this."""
NEAR = 0.01
"""Gaussians whose centre is nearer than this, in scene units of depth, are not drawn."""


@dataclass(frozen=True, eq=False)
class Rendering:
    """What one render gives."""

    rgb: FloatArray
    """(H, W, 3) colour over the background; not clipped above 1."""
    alpha: FloatArray
    """(H, W) accumulated opacity, 1 - T."""
    expected_depth: FloatArray
    """(H, W) sum(w z) / alpha, scene units; 0 where alpha is 0."""
    median_depth: FloatArray
    """(H, W) z of the Gaussian at which T crosses 0.5, scene units; 0 where it never does."""
    weight_inside: FloatArray | None = None
    """(N,) sum over pixels of mask * alpha_g T; only where a mask was given."""
    weight_outside: FloatArray | None = None
    """(N,) sum over pixels of (1 - mask) * alpha_g T; only where a mask was given."""


class Renderer(Protocol):
    """Draws Gaussians as a camera sees them."""

    @property
    def name(self) -> str:
        """Name and version of the backend; part of every cache key below it."""
        ...

    def render(
        self,
        gaussians: Gaussians,
        camera: Camera,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        mask: FloatArray | None = None,
    ) -> Rendering:
        """Draw one picture.

        Args:
            gaussians: The set to draw.
            camera: Where from.
            background: Colour behind everything, each channel in [0, 1].
            mask: (H, W) float32 in [0, 1]; where given, the Gaussians' weights inside and
                outside of it are summed in the same pass.
        """
        ...


def _numba() -> Renderer:
    from gvr_core.rendering.numba_renderer import NumbaRenderer

    return NumbaRenderer()


def _gsplat() -> Renderer:
    from gvr_core.rendering.gsplat_renderer import GsplatRenderer

    return GsplatRenderer()


def _torch_reference() -> Renderer:
    from gvr_core.rendering.torch_reference import TorchReference

    return TorchReference()


_BACKENDS: dict[str, Callable[[], Renderer]] = {
    "numba": _numba,
    "gsplat": _gsplat,
    "torch-reference": _torch_reference,
}


def get_renderer(name: str) -> Renderer:
    """The renderer of that name.

    Args:
        name: ``"numba"`` (CPU), ``"gsplat"`` (CUDA) or ``"torch-reference"`` (the slow oracle).

    Raises:
        ConfigError: for a name that is not known, listing those that are; for ``"gsplat"``
            without a CUDA GPU or without the package, saying which and what to do.
    """
    if name not in _BACKENDS:
        raise unknown_name("renderer", name, _BACKENDS)
    return _BACKENDS[name]()
