"""Pictures of answers: the target dyed red in the scene, the truth outlined, the scores below."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont, UnidentifiedImageError
from scipy import ndimage

from gvr_core.errors import InputError
from gvr_core.picture_files import MAX_PIXELS
from reports.sheet import printable

OUTLINE = (86, 180, 233)
"""Sky blue of Okabe and Ito's palette: apart from the target's red for every kind of colour
vision, and lighter than it in grey."""
_CASING = (0, 0, 0)
_PAPER = (255, 255, 255)
_INK = (20, 20, 20)
_SMALLEST_WIDTH = 320
_MAX_QUERY_LINES = 3
_GAP = 8

Array = NDArray[np.float32] | NDArray[np.float64] | NDArray[np.uint8]


def query_picture(image: Array, truth: NDArray[np.bool_] | None = None, caption: str = "") -> bytes:
    """The picture of one query in one view.

    Args:
        image: (H, W, 3) RGB of the scene with the target's Gaussians dyed red; floats in [0, 1]
            (values outside are clipped) or uint8.
        truth: (H, W) exact mask, outlined from outside so that it hides none of the target;
            None where there is none.
        caption: The query's text on the first line, set in bold; scores on further lines.

    Returns:
        PNG. A small image is enlarged by a whole number, so that the caption can be read.

    Raises:
        InputError: for arrays of another shape or type, or numbers that are not finite.
    """
    pixels = _rgb8(image)
    height, width = pixels.shape[:2]
    scale = max(1, -(-_SMALLEST_WIDTH // width))
    pixels = pixels.repeat(scale, axis=0).repeat(scale, axis=1)
    if truth is not None:
        if truth.shape != (height, width) or truth.dtype != np.bool_:
            raise InputError(
                f"a truth mask of shape {truth.shape} and type {truth.dtype}",
                accepted=f"({height}, {width}) bool, the image's size",
            )
        pixels = _outlined(pixels, truth.repeat(scale, axis=0).repeat(scale, axis=1))
    picture = Image.fromarray(pixels)
    strip = _caption_strip(caption, picture.width)
    whole = Image.new("RGB", (picture.width, picture.height + strip.height), _PAPER)
    whole.paste(picture, (0, 0))
    whole.paste(strip, (0, picture.height))
    return _png(whole)


def contact_sheet(pictures: Sequence[bytes], columns: int = 3, width: int = 1200) -> bytes:
    """Pictures in a grid, row by row, each in a cell of the same width.

    Args:
        pictures: Encoded pictures, e.g. from `query_picture`.
        columns: Pictures in a row; fewer where there are fewer pictures.
        width: Width of the sheet, pixels.

    Returns:
        PNG.

    Raises:
        InputError: without pictures, for bytes that are no picture, or for cells below 16 pixels.
    """
    if not pictures:
        raise InputError("no pictures for the contact sheet", accepted="at least one")
    columns = min(columns, len(pictures))
    cell = (width - _GAP * (columns + 1)) // columns if columns > 0 else 0
    if cell < 16:
        raise InputError(
            f"{columns} columns in a sheet {width} pixels wide", accepted="cells of 16 pixels"
        )
    tiles = []
    for i, content in enumerate(pictures):
        try:
            opened = Image.open(io.BytesIO(content), formats=("PNG", "JPEG"))
            if opened.width * opened.height > MAX_PIXELS or opened.height > 20 * opened.width:
                raise OSError(f"{opened.width} x {opened.height} pixels")
            tile = opened.convert("RGB")
        except (UnidentifiedImageError, OSError, ValueError, SyntaxError) as error:
            raise InputError(
                f"not a picture: {error}", place=f"pictures[{i}]", accepted="PNG or JPEG bytes"
            ) from error
        size = (cell, max(1, round(tile.height * cell / tile.width)))
        tiles.append(tile.resize(size, Image.Resampling.LANCZOS))
    rows = [tiles[i : i + columns] for i in range(0, len(tiles), columns)]
    height = _GAP + sum(max(tile.height for tile in row) + _GAP for row in rows)
    sheet = Image.new("RGB", (width, height), _PAPER)
    top = _GAP
    for row in rows:
        for i, tile in enumerate(row):
            sheet.paste(tile, (_GAP + i * (cell + _GAP), top))
        top += max(tile.height for tile in row) + _GAP
    return _png(sheet)


def _rgb8(image: Array) -> NDArray[np.uint8]:
    shape_fits = image.ndim == 3 and image.shape[2] == 3 and image.size > 0
    if not shape_fits or not (image.dtype == np.uint8 or np.issubdtype(image.dtype, np.floating)):
        raise InputError(
            f"an image of shape {image.shape} and type {image.dtype}",
            accepted="(H, W, 3) of uint8, or of floats in [0, 1]",
        )
    if image.dtype == np.uint8:
        return image.astype(np.uint8, copy=False)
    if not np.isfinite(image).all():
        raise InputError("an image with NaN or infinity", accepted="floats in [0, 1]")
    return np.rint(np.clip(image.astype(np.float64), 0.0, 1.0) * 255.0).astype(np.uint8)


def _outlined(pixels: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """A line of sky blue around the mask, between two thin dark ones that set it off."""
    line = max(3, min(pixels.shape[:2]) // 110)
    outside = ndimage.distance_transform_edt(~mask) if mask.any() else np.full(mask.shape, np.inf)
    drawn = pixels.copy()
    drawn[(outside > 0) & (outside <= line + 2)] = _CASING
    drawn[(outside > 1) & (outside <= line + 1)] = OUTLINE
    return drawn


def _caption_strip(caption: str, width: int) -> Image.Image:
    size = max(13, width // 32)
    pad = size // 2
    first, *rest = caption.split("\n") if caption else [""]
    lines = [(text, _font(size, bold=True)) for text in _fit(first, size, width - 2 * pad, True)]
    for text in rest:
        lines += [(t, _font(size, bold=False)) for t in _fit(text, size, width - 2 * pad, False)]
    step = round(size * 1.35)
    height = 2 * pad + step * len(lines) if caption else 0
    strip = Image.new("RGB", (width, height), _PAPER)
    draw = ImageDraw.Draw(strip)
    for i, (text, font) in enumerate(lines):
        draw.text((pad, pad + i * step), text, fill=_INK, font=font)
    return strip


def _fit(text: str, size: int, room: int, bold: bool) -> list[str]:
    """Break a text into lines no wider than ``room``; what does not fit ends in an ellipsis."""
    font = _font(size, bold)
    text = printable(text)
    per_line = max(4, int(room / (font.getlength("n") or 1)))
    lines = textwrap.wrap(text, per_line, max_lines=_MAX_QUERY_LINES, placeholder=" …") or [""]
    # Letters differ in width: narrow the lines until the widest one really fits.
    while per_line > 4 and max(font.getlength(line) for line in lines) > room:
        per_line -= 1
        lines = textwrap.wrap(text, per_line, max_lines=_MAX_QUERY_LINES, placeholder=" …")
    return lines


@cache
def _font(size: int, bold: bool) -> ImageFont.FreeTypeFont:
    # matplotlib brings this font along, so that pictures look alike on every machine.
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name), size)


def _png(picture: Image.Image) -> bytes:
    file = io.BytesIO()
    picture.save(file, "PNG", optimize=True)
    return file.getvalue()
