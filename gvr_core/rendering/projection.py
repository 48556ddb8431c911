"""From the world to the picture: mean, covariance and extent of each Gaussian.

Perspective projection with the affine approximation of EWA splatting (Zwicker et al., 2001), as
in 3D Gaussian Splatting (Kerbl et al., 2023): Sigma' = J W Sigma W^T J^T. As in gsplat, the point
at which the Jacobian J is taken has x/z clamped to [-(cx / fx + 0.3 tan), (width - cx) / fx +
0.3 tan] with tan = width / (2 fx), and y/z likewise: 1.3 times the half field of view where the
principal point is in the middle. Outside of it the approximation would blow Gaussians up.

Only the mean is projected in double: in float32 it would be off by 1e-4 pixels and more, which
Gaussians of a pixel's size show. All else is float32.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gvr_core.cameras import Camera
from gvr_core.rendering.base import ALPHA_MIN, LOW_PASS, NEAR
from gvr_core.rendering.compiled import kernel
from gvr_core.rendering.layout import (
    COLUMN,
    DEPTH,
    EXPONENT_SCALE,
    EXTENT_Y,
    HIGHEST_X,
    MEAN_X,
    MEAN_Y,
    REST_X,
    REST_Y,
    RIGHTMOST_Y,
    T0,
    T_MIN,
    TILE,
    A,
    B,
    C,
    Window,
)

FloatArray = NDArray[np.float32]
Float64Array = NDArray[np.float64]

_ZERO, _ONE, _TWO, _EIGHTH = np.float32(0), np.float32(1), np.float32(2), np.float32(0.125)
_TINY, _HUGE = np.float32(1e-24), np.float32(1e36)
_LOW_PASS, _ALPHA_MIN, _NEAR = np.float32(LOW_PASS), np.float32(ALPHA_MIN), np.float32(NEAR)
_KAPPA = np.float32(EXPONENT_SCALE)
_REACH = np.float32(1 / EXPONENT_SCALE)


def camera_numbers(
    camera: Camera, window: Window | None = None
) -> tuple[Float64Array, Float64Array, FloatArray, FloatArray]:
    """A camera as the kernel takes it.

    Args:
        camera: The camera.
        window: The tiles to draw; None for all of the picture.

    Returns:
        ``pose`` (3, 4) float64: world to camera. ``lens`` (4,) float64: fx, fy, cx, cy.
        ``rotation`` (3, 3) float32: that of the pose. ``limits`` (8,) float32: lowest and
        highest x/z and lowest and highest y/z of the Jacobian; left, right, top and bottom of
        what is drawn, pixels.
    """
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    margin_x, margin_y = 0.15 * camera.width / fx, 0.15 * camera.height / fy
    limits = [
        *(-cx / fx - margin_x, (camera.width - cx) / fx + margin_x),
        *(-cy / fy - margin_y, (camera.height - cy) / fy + margin_y),
        *(0, camera.width, 0, camera.height),
    ]
    if window is not None:
        columns, rows = window.columns, window.rows
        limits[4:6] = TILE * columns[0], min(TILE * columns[1], camera.width)
        limits[6:8] = TILE * rows[0], min(TILE * rows[1], camera.height)
    pose = np.ascontiguousarray(camera.world_to_camera[:3], dtype=np.float64)
    return (
        pose,
        np.array([fx, fy, cx, cy], dtype=np.float64),
        np.ascontiguousarray(pose[:, :3], dtype=np.float32),
        np.array(limits, dtype=np.float32),
    )


@kernel
def project(
    start: int,
    stop: int,
    means: FloatArray,
    scales: FloatArray,
    quats: FloatArray,
    opacities: FloatArray,
    pose: Float64Array,
    lens: Float64Array,
    rotation: FloatArray,
    limits: FloatArray,
    shown: NDArray[np.bool_],
    rows: FloatArray,
    seen: NDArray[np.bool_],
) -> None:
    """Fill the rows of the Gaussians ``start`` to ``stop`` - 1, all but their colours.

    Args:
        start: First Gaussian.
        stop: One past the last.
        means: (N, 3) float32, world frame.
        scales: (N, 3) float32.
        quats: (N, 4) float32, wxyz; normalised here.
        opacities: (N,) float32.
        pose: (3, 4), see :func:`camera_numbers`, as the next three.
        lens: (4,).
        rotation: (3, 3).
        limits: (8,).
        shown: (N,) bool; the others are passed over.
        rows: (N, 16) float32, written where seen.
        seen: (N,) bool, written: whether any pixel drawn can have an alpha of 1/255.
    """
    for i in range(start, stop):
        seen[i] = False
        opacity = opacities[i]
        if not (shown[i] and opacity >= _ALPHA_MIN):
            continue
        px, py, pz = means[i, 0], means[i, 1], means[i, 2]
        wide_z = pose[2, 0] * px + pose[2, 1] * py + pose[2, 2] * pz + pose[2, 3]
        z = np.float32(wide_z)
        if not z >= _NEAR:
            continue
        wide_x = pose[0, 0] * px + pose[0, 1] * py + pose[0, 2] * pz + pose[0, 3]
        wide_y = pose[1, 0] * px + pose[1, 1] * py + pose[1, 2] * pz + pose[1, 3]
        slope_x, slope_y = wide_x / wide_z, wide_y / wide_z
        wide_mean_x, wide_mean_y = lens[0] * slope_x + lens[2], lens[1] * slope_y + lens[3]
        mean_x, mean_y = np.float32(wide_mean_x), np.float32(wide_mean_y)

        # T = J W, the 2 x 3 map from world offsets to pixels.
        u = min(max(np.float32(slope_x), limits[0]), limits[1])
        v = min(max(np.float32(slope_y), limits[2]), limits[3])
        zoom_x, zoom_y = np.float32(lens[0]) / z, np.float32(lens[1]) / z
        tx0 = zoom_x * (rotation[0, 0] - u * rotation[2, 0])
        tx1 = zoom_x * (rotation[0, 1] - u * rotation[2, 1])
        tx2 = zoom_x * (rotation[0, 2] - u * rotation[2, 2])
        ty0 = zoom_y * (rotation[1, 0] - v * rotation[2, 0])
        ty1 = zoom_y * (rotation[1, 1] - v * rotation[2, 1])
        ty2 = zoom_y * (rotation[1, 2] - v * rotation[2, 2])

        # M = T R S: where the three scaled axes of the Gaussian fall in the picture.
        qw, qx, qy, qz = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
        norm = _ONE / math.sqrt(max(qw * qw + qx * qx + qy * qy + qz * qz, _TINY))
        qw, qx, qy, qz = qw * norm, qx * norm, qy * norm, qz * norm
        s0, s1, s2 = scales[i, 0], scales[i, 1], scales[i, 2]
        r00 = _ONE - _TWO * (qy * qy + qz * qz)
        r01 = _TWO * (qx * qy - qw * qz)
        r02 = _TWO * (qx * qz + qw * qy)
        r10 = _TWO * (qx * qy + qw * qz)
        r11 = _ONE - _TWO * (qx * qx + qz * qz)
        r12 = _TWO * (qy * qz - qw * qx)
        r20 = _TWO * (qx * qz - qw * qy)
        r21 = _TWO * (qy * qz + qw * qx)
        r22 = _ONE - _TWO * (qx * qx + qy * qy)
        a0 = s0 * (tx0 * r00 + tx1 * r10 + tx2 * r20)
        a1 = s1 * (tx0 * r01 + tx1 * r11 + tx2 * r21)
        a2 = s2 * (tx0 * r02 + tx1 * r12 + tx2 * r22)
        b0 = s0 * (ty0 * r00 + ty1 * r10 + ty2 * r20)
        b1 = s1 * (ty0 * r01 + ty1 * r11 + ty2 * r21)
        b2 = s2 * (ty0 * r02 + ty1 * r12 + ty2 * r22)

        xx = a0 * a0 + a1 * a1 + a2 * a2
        yy = b0 * b0 + b1 * b1 + b2 * b2
        xy = a0 * b0 + a1 * b1 + a2 * b2
        # det(M M^T) as the squares of M's minors (Cauchy-Binet): xx yy - xy^2 would cancel.
        m01, m02, m12 = a0 * b1 - a1 * b0, a0 * b2 - a2 * b0, a1 * b2 - a2 * b1
        det = m01 * m01 + m02 * m02 + m12 * m12 + _LOW_PASS * (xx + yy) + _LOW_PASS * _LOW_PASS
        xx += _LOW_PASS
        yy += _LOW_PASS
        if not det < _HUGE:
            continue

        t0 = _EIGHTH * math.log2(opacity)
        limit = t0 - T_MIN
        reach = _REACH * math.sqrt(max(limit, _ZERO))
        extent_x, extent_y = reach * math.sqrt(xx), reach * math.sqrt(yy)
        if not (
            mean_x + extent_x > limits[4]
            and mean_x - extent_x < limits[5]
            and mean_y + extent_y > limits[6]
            and mean_y - extent_y < limits[7]
        ):
            continue
        seen[i] = True
        slant = xy / yy
        narrow = _KAPPA * math.sqrt(yy / det)
        row = rows[i]
        row[MEAN_X], row[MEAN_Y] = mean_x, mean_y
        row[REST_X] = np.float32(wide_mean_x - mean_x)
        row[REST_Y] = np.float32(wide_mean_y - mean_y)
        row[A], row[B], row[C] = narrow, narrow * slant, _KAPPA / math.sqrt(yy)
        row[T0], row[DEPTH] = t0, z
        row[EXTENT_Y], row[RIGHTMOST_Y] = extent_y, reach * xy / math.sqrt(xx)
        row[HIGHEST_X], row[COLUMN] = slant * extent_y, det / (_KAPPA * _KAPPA * xx)
