"""The one door to encoded pictures: their headers are weighed before any pixel is decoded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from PIL import Image

from gvr_core.errors import DatasetError

MAX_PIXELS = 80_000_000
"""A larger picture is refused before its pixels are decoded: 80 million take 240 MB as RGB.
It lies below the number at which Pillow itself begins to warn."""


@contextmanager
def open_picture(path: Path, formats: Sequence[str]) -> Iterator[Image.Image]:
    """An opened picture of at most :data:`MAX_PIXELS`, its pixels not yet decoded.

    Whatever fails in the block fails as decoding does: there should be nothing else in it.

    Args:
        path: The file.
        formats: What it may be, by Pillow's names.

    Raises:
        DatasetError: if the file is missing, no picture, damaged or too large.
    """
    try:
        if not path.is_file():
            raise DatasetError(
                "this is a folder" if path.is_dir() else "no such file",
                path=path,
                accepted=f"a picture: {', '.join(formats)}",
            )
        with Image.open(path, formats=tuple(formats)) as picture:
            width, height = picture.size
            if width * height > MAX_PIXELS:
                raise DatasetError(
                    f"the picture has {width} x {height} pixels",
                    path=path,
                    accepted=f"up to {MAX_PIXELS} pixels",
                )
            yield picture
    except DatasetError:
        raise
    except Exception as error:
        # Decoders answer damaged files with errors of many kinds, and none is a fault of ours.
        raise DatasetError(
            f"the picture cannot be decoded: {error}",
            path=path,
            accepted=f"a whole picture: {', '.join(formats)}",
        ) from error
