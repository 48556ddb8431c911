"""Photographs as frames that models take."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.models.base import Frame


def photograph_frame(rgb8: NDArray[np.uint8]) -> Frame:
    """A frame without depth, so that all of it is asked; its camera stands anywhere.

    Args:
        rgb8: (H, W, 3) uint8.
    """
    height, width = rgb8.shape[:2]
    pose = look_at((0, -3, 1), (0, 0, 0), (0, 0, 1))
    camera = Camera(intrinsics(50, width, height), pose, width, height)
    rgb = (rgb8 / np.float32(255)).astype(np.float32)
    return Frame(rgb, np.zeros((height, width), np.float32), camera)
