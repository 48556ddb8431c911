"""Contact sheets: one picture that shows what a data set, or one scene of it, looks like.

``python -m datasets.contact_sheet stress docs/pictures/stress.png`` shows the first test view of
every scene; with ``--scene NAME`` all views of that scene.
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from datasets.base import Dataset
from datasets.images import read_image
from datasets.registry import get_dataset
from gvr_core.atomic import atomic_write
from gvr_core.errors import DatasetError, GVRError, unknown_name

RGB8 = NDArray[np.uint8]

LABEL = 18
"""Height of the line above each picture, pixels."""


def scene_tiles(dataset: Dataset) -> list[tuple[str, RGB8]]:
    """One labelled picture a scene: its first test view, or its first view.

    Args:
        dataset: Every scene of it is loaded, and made where it is not there yet.

    Returns:
        Scene name and (H, W, 3) uint8 picture, in the data set's order.
    """
    tiles = []
    for scene in dataset.scenes():
        data = dataset.load(scene)
        view = (*data.truth.test_views, *data.scene.views)[0]
        tiles.append((scene, _picture(view.image, scene)))
    return tiles


def view_tiles(dataset: Dataset, scene: str) -> list[tuple[str, RGB8]]:
    """Every view of a scene with its name, the knowledge views first."""
    if scene not in dataset.scenes():
        raise unknown_name(f"scene of {dataset.name}", scene, dataset.scenes())
    data = dataset.load(scene)
    views = (*data.scene.views, *data.truth.test_views)
    return [(view.name, _picture(view.image, scene)) for view in views]


def contact_sheet(tiles: Sequence[tuple[str, RGB8]], columns: int, width: int) -> RGB8:
    """Pictures side by side, each under its label.

    Args:
        tiles: Label and (H, W, 3) uint8 picture of each; all of one shape.
        columns: Pictures in a row.
        width: Width of each in the sheet, pixels.

    Returns:
        (H', W', 3) uint8.
    """
    height = round(width * tiles[0][1].shape[0] / tiles[0][1].shape[1])
    rows = -(-len(tiles) // columns)
    sheet = Image.new("RGB", (columns * width, rows * (height + LABEL)), "white")
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(LABEL - 5)
    for i, (label, picture) in enumerate(tiles):
        x, y = i % columns * width, i // columns * (height + LABEL)
        draw.text((x + 4, y + 1), label, fill="black", font=font)
        shrunk = Image.fromarray(picture).resize((width, height), Image.Resampling.LANCZOS)
        sheet.paste(shrunk, (x, y + LABEL))
    return np.asarray(sheet)


def write_sheet(path: Path, sheet: RGB8, colours: int = 128) -> None:
    """A sheet as a PNG with a palette: a third of the bytes, and good enough to look at.

    Args:
        path: Where to.
        sheet: (H, W, 3) uint8.
        colours: Size of the palette, 2 to 256.
    """
    packed = io.BytesIO()
    Image.fromarray(sheet).quantize(colours).save(packed, "PNG", optimize=True)
    with atomic_write(path) as file:
        file.write(packed.getvalue())


def main(arguments: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m datasets.contact_sheet", description=__doc__)
    parser.add_argument("dataset", help="name of a data set, or folder:PATH")
    parser.add_argument("picture", type=Path, help="PNG to write")
    parser.add_argument("--scene", help="all views of this scene instead of one of each")
    parser.add_argument("--columns", type=int, default=5)
    parser.add_argument("--width", type=int, default=224, help="of each picture, pixels")
    given = parser.parse_args(arguments)
    try:
        dataset = get_dataset(given.dataset, {})
        tiles = view_tiles(dataset, given.scene) if given.scene else scene_tiles(dataset)
        write_sheet(given.picture, contact_sheet(tiles, given.columns, given.width))
    except GVRError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def _picture(image: Path | None, scene: str) -> RGB8:
    if image is None:
        raise DatasetError(f"scene {scene!r} has no pictures", accepted="views with pictures")
    return read_image(image)


if __name__ == "__main__":
    sys.exit(main())
