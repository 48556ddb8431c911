"""The CUDA renderer: gsplat's kernels, under the conventions and behind the protocol of all.

gsplat (Ye et al., 2024) draws colour, alpha and expected depth of several views in one call. What
it does not have, :mod:`gvr_core.rendering.gsplat_view` makes from its projection: the median depth
from the list of blended pairs, the weights of masks from a gradient.

The conventions need no care: gsplat's are the project's (near plane, 0.3 px low-pass, alpha from
1/255 to 0.999, stop at T = 1e-4, order of depth with ties in order of index). It computes in
float32 throughout, where the CPU renderer keeps what cancels apart.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import sparse
from torch import Tensor

from gvr_core.cameras import Camera
from gvr_core.gaussians import Gaussians
from gvr_core.rendering.base import LOW_PASS, NEAR, Rendering
from gvr_core.rendering.gsplat_functions import (
    TILE,
    GsplatFunctions,
    gsplat_functions,
    load_kernels,
)
from gvr_core.rendering.gsplat_view import ProjectedView, median_depth, views_of, weight_sums
from gvr_core.rendering.inputs import (
    checked_background,
    checked_mask,
    checked_masks,
    checked_shown,
)

FloatArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]

PAIRS_AT_ONCE = 8_000_000
"""Most pairs of view and Gaussian in one call; each takes about 300 bytes of the card's memory."""
VIEWS_AT_ONCE = 32


@dataclass(frozen=True, eq=False)
class DeviceGaussians:
    """A set of Gaussians on the card, moved near the origin."""

    means: Tensor
    """(N, 3) float32, less ``origin``."""
    scales: Tensor
    quats: Tensor
    opacities: Tensor
    sh: Tensor
    degree: int
    origin: NDArray[np.float64]
    """(3,) world frame."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """One view as gsplat drew it, on the card."""

    rgb: Tensor
    """(H, W, 3)."""
    alpha: Tensor
    """(H, W)."""
    expected_depth: Tensor
    """(H, W)."""
    view: ProjectedView


class GsplatRenderer:
    """Draws Gaussians on a CUDA GPU.

    Args:
        api: gsplat, or what stands for it; None for the installed one, whose CUDA code is compiled
            or loaded at the first picture.
        version: Version of ``api``; part of the name.
        device: Where ``api`` computes.

    Raises:
        ConfigError: without a CUDA GPU or without gsplat, saying which and what to do.
    """

    def __init__(
        self,
        api: GsplatFunctions | None = None,
        version: str = "",
        device: str = "cuda",
    ) -> None:
        self._loaded = api is not None
        if api is None:
            api, version = gsplat_functions()
        self._api, self._version, self._device = api, version, torch.device(device)
        self._last: tuple[weakref.ref[Gaussians], DeviceGaussians] | None = None

    @property
    def name(self) -> str:
        """Name and version of the backend; gsplat's version may change a picture."""
        return f"gsplat/1/{self._version}"

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
            ConfigError: at the first picture, where gsplat's CUDA code does not load.
        """
        portion = None if mask is None else checked_mask(mask, camera)
        (drawn,) = self._draw(gaussians, [camera], checked_background(background), shown)
        picture = self._finished(drawn)
        if portion is None:
            return picture
        both = self._sent(np.stack([portion, 1 - portion]))
        inside, outside = _array(weight_sums(self._api, drawn.view, both))
        return replace(picture, weight_inside=inside, weight_outside=outside)

    def render_many(
        self,
        gaussians: Gaussians,
        cameras: Sequence[Camera],
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        shown: BoolArray | None = None,
    ) -> Iterator[Rendering]:
        """Draw several pictures; neighbours of one size in one call of gsplat.

        See :class:`gvr_core.rendering.base.Renderer`.

        Raises:
            InputError: for a background or flags that do not fit.
            ConfigError: at the first picture, where gsplat's CUDA code does not load.
        """
        colour = checked_background(background)
        for drawn in self._draw(gaussians, cameras, colour, shown):
            yield self._finished(drawn)

    def weights(
        self,
        gaussians: Gaussians,
        camera: Camera,
        masks: BoolArray,
        shown: BoolArray | None = None,
    ) -> sparse.csr_array:
        """How much of what is under each mask is each Gaussian's.

        See :class:`gvr_core.rendering.base.Renderer`. gsplat adds with atomics: the last digits
        differ from call to call.

        Args:
            gaussians: The set to draw.
            camera: The camera of the masks.
            masks: (K, H, W) bool.
            shown: (N,) flags of the Gaussians to draw; None for all.

        Returns:
            (N, K) float32, sparse.

        Raises:
            InputError: for masks or flags that do not fit.
            ConfigError: at the first picture, where gsplat's CUDA code does not load.
        """
        portions = self._sent(checked_masks(masks, camera)).to(torch.float32)
        black = np.zeros(3, np.float32)
        (drawn,) = self._draw(gaussians, [camera], black, shown)
        return sparse.csr_array(_array(weight_sums(self._api, drawn.view, portions)).T)

    def _draw(
        self,
        gaussians: Gaussians,
        cameras: Sequence[Camera],
        background: FloatArray,
        shown: BoolArray | None,
    ) -> Iterator[Drawn]:
        flags = None if shown is None else checked_shown(shown, len(gaussians))
        if not self._loaded:
            load_kernels()
            self._loaded = True
        scene = self._on_device(gaussians)
        if flags is not None:
            # gsplat culls what is fainter than 1/255 before anything else.
            hidden = self._sent(~flags)
            scene = replace(scene, opacities=scene.opacities.masked_fill(hidden, 0))
        most = max(1, min(VIEWS_AT_ONCE, PAIRS_AT_ONCE // len(gaussians)))
        for batch in batches(cameras, most):
            yield from self._rasterize(scene, batch, background)

    # Not inference_mode: its tensors could not take part in the gradient of the weights.
    @torch.no_grad()
    def _rasterize(
        self, scene: DeviceGaussians, cameras: Sequence[Camera], background: FloatArray
    ) -> list[Drawn]:
        poses, lenses = camera_matrices(cameras, scene.origin)
        colours, alphas, meta = self._api.rasterization(
            means=scene.means,
            quats=scene.quats,
            scales=scene.scales,
            opacities=scene.opacities,
            colors=scene.sh,
            viewmats=self._sent(poses),
            Ks=self._sent(lenses),
            width=cameras[0].width,
            height=cameras[0].height,
            near_plane=NEAR,
            eps2d=LOW_PASS,
            sh_degree=scene.degree,
            packed=False,  # the lists of blended pairs exist for this layout only
            tile_size=TILE,
            backgrounds=self._sent(background).repeat(len(cameras), 1),
            render_mode="RGB+ED",
        )
        return [
            Drawn(colours[i, ..., :3], alphas[i, ..., 0], colours[i, ..., 3], view)
            for i, view in enumerate(views_of(meta))
        ]

    def _finished(self, drawn: Drawn) -> Rendering:
        return Rendering(
            rgb=_array(drawn.rgb),
            alpha=_array(drawn.alpha),
            expected_depth=_array(drawn.expected_depth),
            median_depth=_array(median_depth(self._api, drawn.view)),
        )

    def _on_device(self, gaussians: Gaussians) -> DeviceGaussians:
        """The set on the card; the last one stays there for as long as it lives."""
        if self._last is not None and self._last[0]() is gaussians:
            return self._last[1]
        origin = exact_origin(gaussians.means)
        scene = DeviceGaussians(
            means=self._sent((gaussians.means - origin).astype(np.float32)),
            scales=self._sent(gaussians.scales),
            quats=self._sent(gaussians.quats),
            opacities=self._sent(gaussians.opacities),
            sh=self._sent(gaussians.sh),
            degree=gaussians.sh_degree,
            origin=origin,
        )
        self._last = (weakref.ref(gaussians, self._forget), scene)
        return scene

    def _sent(self, array: NDArray[Any]) -> Tensor:
        # A copy: on a processor torch would share memory that may be read-only.
        return torch.tensor(np.ascontiguousarray(array), device=self._device)

    def _forget(self, reference: weakref.ref[Gaussians]) -> None:
        if self._last is not None and self._last[0] is reference:
            self._last = None


def batches(cameras: Sequence[Camera], most: int) -> Iterator[Sequence[Camera]]:
    """Neighbours of equal picture size, at most so many at once.

    Args:
        cameras: The cameras, whose order is kept.
        most: In one batch.
    """
    start = 0
    for end in range(1, len(cameras) + 1):
        if (
            end < len(cameras)
            and end - start < most
            and _size(cameras[end]) == _size(cameras[start])
        ):
            continue
        yield cameras[start:end]
        start = end


def exact_origin(means: FloatArray) -> NDArray[np.float64]:
    """A point near the middle of a set, such that taking it off loses no digit.

    A scene far from the origin would lose in gsplat's float32 what it is apart by. Along each axis
    the point is the middle of a scene that lies further off than three times its own size, where
    the difference of two float32 numbers is exact (Sterbenz, 1974), and 0 of all others.

    Args:
        means: (N, 3) float32, world frame.

    Returns:
        (3,) float64, world frame.
    """
    low, high = means.min(axis=0), means.max(axis=0)
    middle = ((low + high) / 2).astype(np.float64)
    origin: NDArray[np.float64] = np.where(np.abs(middle) > 3 * (high - low), middle, 0)
    return origin


def camera_matrices(
    cameras: Sequence[Camera], origin: NDArray[np.float64]
) -> tuple[FloatArray, FloatArray]:
    """World-to-camera matrices of a world moved by ``-origin``, and intrinsics.

    Args:
        cameras: The n cameras.
        origin: (3,) world frame.

    Returns:
        (n, 4, 4) and (n, 3, 3) float32.
    """
    poses = np.stack([camera.world_to_camera for camera in cameras]).astype(np.float64)
    poses[:, :3, 3] += poses[:, :3, :3] @ origin
    lenses = np.stack([camera.K for camera in cameras])
    return poses.astype(np.float32), lenses.astype(np.float32)


def _size(camera: Camera) -> tuple[int, int]:
    return camera.width, camera.height


def _array(tensor: Tensor) -> FloatArray:
    array: FloatArray = tensor.detach().to("cpu", torch.float32).contiguous().numpy()
    return array
