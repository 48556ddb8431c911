"""Colour of each Gaussian as seen from the camera: real spherical harmonics, degrees 0 to 3.

The basis and its signs are those of 3D Gaussian Splatting (Kerbl et al., 2023), which evaluates
it in the direction from the camera to the mean; the colour is max(0, 0.5 + sum).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gvr_core.rendering.compiled import kernel
from gvr_core.rendering.layout import RED

FloatArray = NDArray[np.float32]

# Normalisation constants of the real spherical harmonics, e.g. Y_1m = sqrt(3 / (4 pi)) x.
_C0 = np.float32(math.sqrt(1 / (4 * math.pi)))
_C1 = np.float32(math.sqrt(3 / (4 * math.pi)))
_C2_XY = np.float32(math.sqrt(15 / (4 * math.pi)))
_C2_ZZ = np.float32(math.sqrt(5 / (16 * math.pi)))
_C2_XX_YY = np.float32(math.sqrt(15 / (16 * math.pi)))
_C3_3 = np.float32(math.sqrt(35 / (32 * math.pi)))
_C3_XYZ = np.float32(math.sqrt(105 / (4 * math.pi)))
_C3_1 = np.float32(math.sqrt(21 / (32 * math.pi)))
_C3_0 = np.float32(math.sqrt(7 / (16 * math.pi)))
_C3_2 = np.float32(math.sqrt(105 / (16 * math.pi)))
_ZERO, _HALF, _ONE, _TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
_THREE, _FOUR, _FIVE = np.float32(3), np.float32(4), np.float32(5)
_TINY = np.float32(1e-30)


@kernel
def shade(
    start: int,
    stop: int,
    order: NDArray[np.int32],
    means: FloatArray,
    sh: FloatArray,
    position: NDArray[np.float64],
    rows: FloatArray,
) -> None:
    """Fill in the colours of the Gaussians ``order[start]`` to ``order[stop - 1]``.

    Args:
        start: First entry of ``order``.
        stop: One past the last.
        order: (n,) int32, the Gaussians seen.
        means: (N, 3) float32, world frame.
        sh: (N, K, 3) float32.
        position: (3,) float64, centre of the camera, world frame.
        rows: (N, 16) float32; columns RED, GREEN and BLUE are written.
    """
    basis = np.zeros(16, np.float32)
    basis[0] = _C0
    coefficients = sh.shape[1]
    for n in range(start, stop):
        i = order[n]
        if coefficients > 1:
            # The difference in double: far from the origin, float32 would lose the direction.
            x = np.float32(means[i, 0] - position[0])
            y = np.float32(means[i, 1] - position[1])
            z = np.float32(means[i, 2] - position[2])
            norm = _ONE / math.sqrt(max(x * x + y * y + z * z, _TINY))
            x, y, z = x * norm, y * norm, z * norm
            basis[1], basis[2], basis[3] = -_C1 * y, _C1 * z, -_C1 * x
            if coefficients > 4:
                xx, yy, zz = x * x, y * y, z * z
                basis[4] = _C2_XY * x * y
                basis[5] = -_C2_XY * y * z
                basis[6] = _C2_ZZ * (_TWO * zz - xx - yy)
                basis[7] = -_C2_XY * x * z
                basis[8] = _C2_XX_YY * (xx - yy)
                if coefficients > 9:
                    basis[9] = -_C3_3 * y * (_THREE * xx - yy)
                    basis[10] = _C3_XYZ * x * y * z
                    basis[11] = -_C3_1 * y * (_FOUR * zz - xx - yy)
                    basis[12] = _C3_0 * z * (_TWO * zz - _THREE * xx - _THREE * yy)
                    basis[13] = -_C3_1 * x * (_FOUR * zz - xx - yy)
                    basis[14] = _C3_2 * z * (xx - yy)
                    basis[15] = -_C3_3 * x * (xx - _THREE * yy)
        red, green, blue = _HALF, _HALF, _HALF
        for k in range(coefficients):
            red += basis[k] * sh[i, k, 0]
            green += basis[k] * sh[i, k, 1]
            blue += basis[k] * sh[i, k, 2]
        rows[i, RED] = max(red, _ZERO)
        rows[i, RED + 1] = max(green, _ZERO)
        rows[i, RED + 2] = max(blue, _ZERO)
