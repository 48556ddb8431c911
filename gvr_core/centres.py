"""Which Gaussians' centres project into a mask: the test of frustum filtering, in one pass."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gvr_core.cameras import Camera
from gvr_core.rendering.compiled import available_threads, precise_kernel, run_pieces

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float32]
Float64Array = NDArray[np.float64]

_CENTRES_A_PIECE = 32768


def centres_under(
    means: FloatArray, camera: Camera, mask: BoolArray, asked: BoolArray | None = None
) -> BoolArray:
    """Whether each centre is in front of the camera and projects into the mask.

    Args:
        means: (N, 3) centres, world frame.
        camera: The camera that the mask belongs to.
        mask: (H, W).
        asked: (N,) flags of the centres to look at; the others are not flagged. None for all.

    Returns:
        (N,) flags.
    """
    n = len(means)
    flags = np.ones(n, np.bool_) if asked is None else np.array(asked, np.bool_)
    points, pixels = np.ascontiguousarray(means), np.ascontiguousarray(mask)
    pose = np.ascontiguousarray(camera.world_to_camera[:3], np.float64)
    lens = np.array([camera.K[at] for at in ((0, 0), (1, 1), (0, 2), (1, 2))], np.float64)
    step = _CENTRES_A_PIECE

    def look_up(piece: int) -> None:
        _look_up(piece * step, min((piece + 1) * step, n), points, pose, lens, pixels, flags)

    run_pieces(look_up, -(-n // step), available_threads())
    return flags


@precise_kernel
def _look_up(
    start: int,
    stop: int,
    means: FloatArray,
    pose: Float64Array,
    lens: Float64Array,
    mask: BoolArray,
    flags: BoolArray,
) -> None:
    height, width = mask.shape
    for i in range(start, stop):
        if not flags[i]:
            continue
        flags[i] = False
        x, y, z = np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2])
        depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        if not depth > 0:
            continue
        across = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
        down = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
        column = np.floor(across / depth * lens[0] + lens[2])
        row = np.floor(down / depth * lens[1] + lens[3])
        if 0 <= column < width and 0 <= row < height:
            flags[i] = mask[np.int64(row), np.int64(column)]
