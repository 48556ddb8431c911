"""What every renderer takes and gives.

Conventions (those of gsplat): activated scales and opacities, wxyz quaternions, world-to-camera
matrices, OpenCV camera axes, depth is z. A low-pass of 0.3 px is added to the projected
covariance; a Gaussian's alpha in a pixel is skipped below 1/255 and clamped at 0.999; blending
stops before the transmittance T falls to 1e-4.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gvr_core import plugins
from gvr_core.cameras import Camera
from gvr_core.errors import unknown_name
from gvr_core.gaussians import Gaussians

FloatArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]

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
        shown: BoolArray | None = None,
    ) -> Rendering:
        """Draw one picture.

        Args:
            gaussians: The set to draw.
            camera: Where from.
            background: Colour behind everything, each channel in [0, 1].
            mask: (H, W) float32 in [0, 1]; where given, the Gaussians' weights inside and
                outside of it are summed in the same pass.
            shown: (N,) flags of the Gaussians to draw; None for all. The picture is that of the
                subset alone, and the weights of the others are 0.
        """
        ...

    def render_many(
        self,
        gaussians: Gaussians,
        cameras: Sequence[Camera],
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        shown: BoolArray | None = None,
    ) -> Iterator[Rendering]:
        """Draw several pictures of the same set: what :meth:`render` gives, bit for bit.

        Args:
            gaussians: The set to draw.
            cameras: Where from.
            background: As of :meth:`render`.
            shown: As of :meth:`render`.

        Yields:
            A picture for each camera, in order; few are held at a time.
        """
        ...

    def weights(
        self,
        gaussians: Gaussians,
        camera: Camera,
        masks: BoolArray,
        shown: BoolArray | None = None,
    ) -> sparse.csr_array:
        """How much of what is under each mask is each Gaussian's.

        Args:
            gaussians: The set to draw.
            camera: The camera of the masks.
            masks: (K, H, W) bool; they may overlap.
            shown: As of :meth:`render`.

        Returns:
            (N, K) float32, sparse: the sum over each mask's pixels of alpha_g T. Column k is
            ``weight_inside`` of :meth:`render` with mask k.
        """
        ...


def one_by_one(
    renderer: Renderer,
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    shown: BoolArray | None = None,
) -> Iterator[Rendering]:
    """The plain loop that :meth:`Renderer.render_many` must agree with.

    Args:
        renderer: Draws the pictures.
        gaussians: As of :meth:`Renderer.render_many`, as the next three.
        cameras: See ``gaussians``.
        background: See ``gaussians``.
        shown: See ``gaussians``.
    """
    for camera in cameras:
        yield renderer.render(gaussians, camera, background, shown=shown)


def mask_by_mask(
    renderer: Renderer,
    gaussians: Gaussians,
    camera: Camera,
    masks: BoolArray,
    shown: BoolArray | None = None,
) -> sparse.csr_array:
    """The plain way to :meth:`Renderer.weights`: one render for each mask.

    Args:
        renderer: Draws the pictures.
        gaussians: As of :meth:`Renderer.weights`, as the next three.
        camera: See ``gaussians``.
        masks: See ``gaussians``.
        shown: See ``gaussians``.
    """
    columns = [np.zeros((len(gaussians), 0), np.float32)]
    for mask in masks:
        drawn = renderer.render(gaussians, camera, mask=mask.astype(np.float32), shown=shown)
        if drawn.weight_inside is None:
            raise TypeError(f"the renderer {renderer.name} sums no weights under a mask")
        columns.append(drawn.weight_inside[:, None])
    return sparse.csr_array(np.concatenate(columns, axis=1))


def _numba() -> Renderer:
    from gvr_core.rendering.numba_renderer import NumbaRenderer

    return NumbaRenderer()


def _gsplat() -> Renderer:
    from gvr_core.rendering.gsplat_renderer import GsplatRenderer

    return GsplatRenderer()


def _torch_reference() -> Renderer:
    from gvr_core.rendering.torch_reference import TorchReference

    return TorchReference()


BACKENDS: dict[str, Callable[[], Renderer]] = {
    "numba": _numba,
    "gsplat": _gsplat,
    "torch-reference": _torch_reference,
}
"""The renderers of the project's own by name."""

PARTS = ("name", "render", "render_many", "weights")
"""What a plugin's renderer must have; see :class:`Renderer`."""


def get_renderer(name: str) -> Renderer:
    """The renderer of that name.

    Args:
        name: ``"numba"`` (CPU), ``"gsplat"`` (CUDA), ``"torch-reference"`` (the slow oracle), or
            the name of a plugin's.

    Raises:
        ConfigError: for a name that is not known, listing those that are; for ``"gsplat"``
            without a CUDA GPU or without the package, saying which and what to do.
        PluginError: for a plugin that cannot be loaded.
    """
    if name in BACKENDS:
        return BACKENDS[name]()
    if not plugins.is_offered(plugins.RENDERERS, name):
        raise unknown_name("renderer", name, [*BACKENDS, *plugins.offered(plugins.RENDERERS)])
    plugin = plugins.load(plugins.RENDERERS, name)
    return cast(Renderer, plugins.Known(plugin.made(PARTS), plugin.origin))
