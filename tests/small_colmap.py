"""A small COLMAP model written by hand."""

from __future__ import annotations

from pathlib import Path

FILES = ("cameras", "images", "points3D")


CAMERAS = "# a comment\n\n1 PINHOLE 640 480 500 501 320 240\n7 SIMPLE_PINHOLE 64 48 50 32 24\n"
IMAGES = (
    "# a comment\n"
    "1 1 0 0 0 0 0 0 1 b/second.jpg\n"
    "10.5 11.5 -1 3.0 4.0 1\n"
    "2 0 2 0 0 1 2 3 7 a first.jpg\n"
    "\n"
)
POINTS = "# a comment\n1 0.5 -1 2e-3 10 20 255 0.1 1 0 2 5\n9 1 2 3 0 0 0 -1\n"


def write_files(folder: Path, **texts: str) -> Path:
    for name, text in texts.items():
        (folder / f"{name}.txt").write_text(text)
    return folder


def write_small_for_binary(folder: Path) -> Path:
    """The small model without the space in a name and the tracks that lead nowhere."""
    return write_files(
        folder,
        images=IMAGES.replace("a first", "a_first"),
        points3D="1 0.5 -1 2e-3 10 20 255 0.1 1 1\n",
    )
