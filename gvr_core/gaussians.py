"""The scene representation: a set of 3D Gaussians, G (N x 59 for spherical harmonics degree 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gvr_core.errors import SplatFormatError

SH_C0 = 0.28209479177387814
"""Value of the constant spherical harmonic, Y_00 = 1 / (2 sqrt(pi))."""

SH_COUNTS = (1, 4, 9, 16)
"""Coefficients per colour channel for spherical harmonics of degree 0, 1, 2 and 3."""

FloatArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Gaussians:
    """N anisotropic Gaussians with activated parameters (nothing is log or logit here).

    The paper's row of 59 numbers is 3 (mean) + 3 (scale) + 4 (rotation) + 1 (opacity) + 48
    (spherical harmonics of degree 3); files with other degrees are read as well.

    Raises:
        SplatFormatError: shapes that do not belong together, no Gaussian at all, or a number
            that is not finite.
    """

    means: FloatArray
    """(N, 3) centres, world frame, scene units."""
    scales: FloatArray
    """(N, 3) standard deviations along the local axes, scene units, linear, >= 0."""
    quats: FloatArray
    """(N, 4) local-to-world rotations as unit quaternions, scalar first (wxyz)."""
    opacities: FloatArray
    """(N,) opacities in [0, 1]."""
    sh: FloatArray
    """(N, K, 3) spherical harmonics of the colour, K in (1, 4, 9, 16)."""

    def __post_init__(self) -> None:
        n = self.means.shape[0] if self.means.ndim == 2 else -1
        k = self.sh.shape[1] if self.sh.ndim == 3 else -1
        expected = {
            "means": (n, 3),
            "scales": (n, 3),
            "quats": (n, 4),
            "opacities": (n,),
            "sh": (n, k, 3),
        }
        if n == 0:
            raise SplatFormatError("the set holds no Gaussian", accepted="one Gaussian or more")
        for name, shape in expected.items():
            array: NDArray[Any] = getattr(self, name)
            if array.shape != shape or min(shape) < 0:
                raise SplatFormatError(
                    f"{name} has shape {array.shape}", accepted=f"{name} of shape {shape}"
                )
            if array.dtype != np.float32:
                raise SplatFormatError(f"{name} has dtype {array.dtype}", accepted="float32")
            finite = np.isfinite(array)
            if not finite.all():
                row = int(np.argwhere(~finite)[0][0])
                raise SplatFormatError(
                    f"{name} of Gaussian {row} is not finite", accepted="finite numbers"
                )
        if k not in SH_COUNTS:
            raise SplatFormatError(
                f"sh has {k} coefficients per channel", accepted=f"one of {SH_COUNTS}"
            )

    def __len__(self) -> int:
        return int(self.means.shape[0])

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return SH_COUNTS.index(self.sh.shape[1])

    def subset(self, flags: BoolArray) -> Gaussians:
        """The Gaussians whose flag is set.

        Args:
            flags: (N,) bool.

        Raises:
            SplatFormatError: if no flag is set.
        """
        return Gaussians(
            self.means[flags],
            self.scales[flags],
            self.quats[flags],
            self.opacities[flags],
            self.sh[flags],
        )

    def contiguous(self) -> Gaussians:
        """The same set with every array in C order; itself where they are already."""
        arrays = (self.means, self.scales, self.quats, self.opacities, self.sh)
        if all(array.flags.c_contiguous for array in arrays):
            return self
        return Gaussians(*(np.ascontiguousarray(array) for array in arrays))

    def recoloured(self, rgb: FloatArray) -> Gaussians:
        """The same Gaussians with flat colours, seen alike from everywhere.

        Args:
            rgb: (N, 3) or (3,) colours in [0, 1].
        """
        flat = np.broadcast_to(np.asarray(rgb, np.float32), (len(self), 3))
        sh = ((flat - np.float32(0.5)) / np.float32(SH_C0)).astype(np.float32)
        return replace(self, sh=np.ascontiguousarray(sh[:, None, :]))

    def dyed(self, flags: BoolArray, rgb: Sequence[float] = (1.0, 0.0, 0.0)) -> Gaussians:
        """The whole set with the flagged Gaussians in one colour; the paper dyes them red.

        Args:
            flags: (N,) bool.
            rgb: The colour, each channel in [0, 1].
        """
        sh = self.sh.copy()
        sh[flags] = 0.0
        sh[flags, 0] = (np.asarray(rgb, np.float32) - np.float32(0.5)) / np.float32(SH_C0)
        return replace(self, sh=sh)

    @classmethod
    def concatenate(cls, parts: Sequence[Gaussians]) -> Gaussians:
        """All the Gaussians of several sets, in order, with the highest degree among them."""
        if not parts:
            raise SplatFormatError("no set of Gaussians to join", accepted="one set or more")
        k = max(part.sh.shape[1] for part in parts)
        padded = [np.pad(p.sh, ((0, 0), (0, k - p.sh.shape[1]), (0, 0))) for p in parts]
        return cls(
            np.concatenate([p.means for p in parts]),
            np.concatenate([p.scales for p in parts]),
            np.concatenate([p.quats for p in parts]),
            np.concatenate([p.opacities for p in parts]),
            np.concatenate(padded),
        )
