"""Checks of what a caller gives a renderer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gvr_core.cameras import Camera
from gvr_core.errors import InputError

FloatArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]


def checked_background(background: tuple[float, float, float]) -> FloatArray:
    """A background colour as an array.

    Args:
        background: Three channels in [0, 1].

    Returns:
        (3,) float32.

    Raises:
        InputError: for another number of channels, or a number outside [0, 1].
    """
    colour = np.asarray(background, dtype=np.float32)
    if colour.shape != (3,) or not ((colour >= 0) & (colour <= 1)).all():
        raise InputError(
            f"the background is {background}",
            accepted="three numbers from 0 to 1: red, green, blue",
        )
    return colour


def checked_mask(mask: FloatArray | NDArray[np.bool_], camera: Camera) -> FloatArray:
    """A mask as a contiguous, writable array, the one kind that kernels are compiled for.

    Args:
        mask: (H, W) of the camera's picture, in [0, 1]; a bool mask is taken as 0 and 1.
        camera: The camera of the picture.

    Returns:
        (H, W) float32.

    Raises:
        InputError: for another shape, or a number outside [0, 1].
    """
    array = np.require(mask, np.float32, ["C", "A", "W"])
    if array.shape != (camera.height, camera.width):
        raise InputError(
            f"the mask has shape {array.shape}",
            accepted=f"one number a pixel, shape {(camera.height, camera.width)}",
        )
    if not ((array >= 0) & (array <= 1)).all():
        raise InputError("the mask holds a number outside [0, 1]", accepted="0 to 1, or bool")
    return array


def checked_masks(masks: BoolArray, camera: Camera) -> BoolArray:
    """Several masks of one picture as a contiguous, writable array.

    Args:
        masks: (K, H, W) of the camera's picture, bool.
        camera: The camera of the picture.

    Raises:
        InputError: for another shape or dtype.
    """
    array = np.require(masks, None, ["C", "A", "W"])
    shape = (camera.height, camera.width)
    if array.ndim != 3 or array.shape[1:] != shape or array.dtype != np.bool_:
        raise InputError(
            f"the masks have shape {array.shape} and dtype {array.dtype}",
            accepted=f"bool of shape (K, {shape[0]}, {shape[1]})",
        )
    return array


def checked_shown(shown: BoolArray | None, n: int) -> BoolArray:
    """Which Gaussians to draw, as a contiguous, writable array.

    Args:
        shown: (N,) bool, or None for all.
        n: N.

    Raises:
        InputError: for another shape or dtype.
    """
    if shown is None:
        return np.ones(n, np.bool_)
    array = np.require(shown, None, ["C", "A", "W"])
    if array.shape != (n,) or array.dtype != np.bool_:
        raise InputError(
            f"the flags of what to draw have shape {array.shape} and dtype {array.dtype}",
            accepted=f"bool of shape ({n},)",
        )
    return array
