"""Pictures and masks on disk.

Pixels are taken as stored: a photograph's orientation tag is not applied, since COLMAP and the
cameras that come from it do not apply it either.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gvr_core.atomic import atomic_write
from gvr_core.errors import DatasetError
from gvr_core.picture_files import MAX_PIXELS, open_picture

__all__ = ["FORMATS", "MAX_PIXELS", "read_image", "read_mask", "write_png"]

FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP")
"""Formats that are decoded, by Pillow's names. MPO is what some phones write as ``.jpg``."""

MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX", "CMYK", "YCbCr")
"""Pillow's pixel modes with 8 bits a channel or fewer."""

MASK_THRESHOLD = 127
"""Foreground is brighter than this where a data set's own protocol names no other number."""


def read_image(path: Path | str, *, size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    """The pixels of a picture.

    Args:
        path: The file.
        size: Width and height in pixels that it must have; any where None.

    Returns:
        (H, W, 3) uint8 RGB. Transparent pixels are blended onto black.

    Raises:
        DatasetError: if the file is missing, no picture, damaged, too large, of another size,
            or has more than 8 bits a channel.
    """
    with _decoded(Path(path), size) as picture:
        if not is_transparent(picture):
            return np.array(picture.convert("RGB"))
        colour = picture.convert("RGBA")
        black = Image.new("RGBA", colour.size, (0, 0, 0, 255))
        return np.array(Image.alpha_composite(black, colour).convert("RGB"))


def read_mask(
    path: Path | str, *, size: tuple[int, int] | None = None, threshold: int = MASK_THRESHOLD
) -> NDArray[np.bool_]:
    """The foreground of a mask picture.

    Args:
        path: The file.
        size: Width and height in pixels that it must have; any where None.
        threshold: Foreground is brighter than this grey value (ITU-R 601 luma for colours), and
            at least half opaque where the picture has an alpha channel.

    Returns:
        (H, W) bool.

    Raises:
        DatasetError: as :func:`read_image`.
    """
    with _decoded(Path(path), size) as picture:
        if not is_transparent(picture):
            return np.array(picture.convert("L")) > threshold
        colour = picture.convert("RGBA")
        opaque = np.array(colour.getchannel("A")) > 127
        foreground: NDArray[np.bool_] = np.array(colour.convert("RGB").convert("L")) > threshold
        return foreground & opaque


def write_png(path: Path | str, array: NDArray[Any]) -> None:
    """Write a picture or a mask as PNG, without loss.

    Args:
        path: The file to make or to replace; it appears whole or not at all.
        array: (H, W, 3) uint8 RGB, (H, W) uint8 grey, or (H, W) bool (written as 0 and 255).

    Raises:
        DatasetError: for an array of another shape or dtype.
        OSError: if the file cannot be written.
    """
    path = Path(path)
    kind = (array.dtype, array.shape[2:])
    if kind not in {(np.dtype(bool), ()), (np.dtype("u1"), ()), (np.dtype("u1"), (3,))} or (
        array.ndim < 2 or array.size == 0
    ):
        raise DatasetError(
            f"an array of shape {array.shape} and dtype {array.dtype} is no picture",
            path=path,
            accepted="(H, W, 3) uint8, (H, W) uint8 or (H, W) bool",
        )
    pixels = array.astype(np.uint8) * np.uint8(255) if array.dtype == bool else array
    with atomic_write(path) as stream:
        Image.fromarray(np.ascontiguousarray(pixels)).save(stream, format="PNG")


@contextmanager
def _decoded(path: Path, size: tuple[int, int] | None) -> Iterator[Image.Image]:
    """A picture with its pixels in memory, once its header is found good."""
    with open_picture(path, FORMATS) as picture:
        _check_header(picture, path, size)
        picture.load()
        yield picture


def _check_header(picture: Image.Image, path: Path, size: tuple[int, int] | None) -> None:
    width, height = picture.size
    if size is not None and picture.size != tuple(size):
        raise DatasetError(
            f"the picture has {width} x {height} pixels",
            path=path,
            accepted=f"{size[0]} x {size[1]}, as its camera has",
        )
    if picture.mode not in MODES:
        raise DatasetError(
            f"the pixels have the mode {picture.mode}",
            path=path,
            accepted="8 bits a channel: grey, palette or RGB, with or without transparency",
        )


def is_transparent(picture: Image.Image) -> bool:
    """Whether a picture has an alpha channel, or a colour that stands for transparent."""
    return picture.mode in ("LA", "PA", "RGBA") or "transparency" in picture.info
