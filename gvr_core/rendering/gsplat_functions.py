"""The three functions of gsplat that the CUDA backend calls, and how it gets hold of them.

gsplat (Ye et al., 2024) is an optional package, and its kernels need a CUDA GPU. All that the
backend asks of it goes through :class:`GsplatFunctions`, whose signatures are gsplat's own, so that
everything around those calls runs and is tested on a processor too.
"""

from __future__ import annotations

import importlib
from importlib import util
from typing import Any, Protocol, cast

import torch
from torch import Tensor

from gvr_core.errors import ConfigError

INSTALL = "pip install 'gvr-bench[cuda]' (or: pip install 'gsplat>=1.5')"
TILE = 16
"""Side of gsplat's tiles, pixels."""
BLOCK = TILE * TILE
"""Gaussians of a tile's list that gsplat's kernels read at once."""


class GsplatFunctions(Protocol):
    """What is used of gsplat >= 1.5; C views, N Gaussians, unpacked."""

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
        near_plane: float = ...,
        *,
        eps2d: float = ...,
        sh_degree: int | None = ...,
        packed: bool = ...,
        tile_size: int = ...,
        backgrounds: Tensor | None = ...,
        render_mode: Any = ...,
    ) -> tuple[Tensor, Tensor, dict[str, Any]]:
        """Pictures (C, H, W, X), alphas (C, H, W, 1), and what was projected and sorted."""
        ...

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
        backgrounds: Tensor | None = ...,
    ) -> tuple[Tensor, Tensor]:
        """Any channels of projected Gaussians, differentiable: (C, H, W, X) and (C, H, W, 1)."""
        ...

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
        """Which Gaussians are blended in which pixels: numbers of Gaussian, pixel and view.

        Only blocks ``range_start`` to ``range_end`` - 1 of each tile's list are looked at. The
        pairs of a pixel stand together, front to back.
        """
        ...


def gsplat_functions() -> tuple[GsplatFunctions, str]:
    """The functions of gsplat and its version, where they can run.

    Nothing is compiled yet: see :func:`load_kernels`.

    Raises:
        ConfigError: where there is no CUDA GPU or no gsplat, saying which and what to do.
    """
    if not torch.cuda.is_available():
        raise ConfigError(
            "the renderer 'gsplat' needs a CUDA GPU, and torch sees none "
            f"(torch {torch.__version__}, torch.cuda.is_available() is False)",
            accepted=f"the renderer 'numba', which runs on the CPU; or a CUDA GPU, and {INSTALL}",
        )
    if util.find_spec("gsplat") is None:
        raise ConfigError(
            "the renderer 'gsplat' needs the package gsplat, which is not installed",
            accepted=INSTALL,
        )
    try:
        module = importlib.import_module("gsplat")
    except Exception as error:  # whatever a package built for another torch raises
        raise ConfigError(
            f"gsplat cannot be imported: {type(error).__name__}: {error}", accepted=INSTALL
        ) from error
    return cast(GsplatFunctions, module), str(getattr(module, "__version__", "unknown"))


def load_kernels() -> None:
    """Load gsplat's CUDA code; a gsplat from PyPI compiles it on first use, for some minutes.

    Raises:
        ConfigError: where it cannot be compiled or loaded.
    """
    accepted = (
        "a CUDA toolkit (nvcc) of the version that torch was built for, or one of gsplat's "
        "prebuilt wheels"
    )
    try:
        kernels = importlib.import_module("gsplat.cuda._backend")._C
    except Exception as error:  # compilers and loaders fail in many ways
        raise ConfigError(
            f"gsplat's CUDA code does not load: {type(error).__name__}: {error}", accepted=accepted
        ) from error
    if kernels is None:
        raise ConfigError("gsplat has no CUDA code: there was no nvcc", accepted=accepted)
