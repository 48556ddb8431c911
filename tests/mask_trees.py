"""Scenes with pictures of masks in a folder for each view, for a test to read or break."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from native_scene import parts, written
from PIL import Image
from small_scene import OBJECTS

from datasets.base import SceneData
from datasets.images import write_png
from datasets.native import read_scene
from gvr_core.cameras import Camera
from gvr_core.rendering.base import Renderer, get_renderer

SCENE = "two-boxes"
PROMPTS = {"red box": "a red box", "blue box": "a blue box"}
"""What stands for an object in the exported trees: its first query."""

Export = Callable[[SceneData, Path, Renderer], Path]


def exported(export: Export, folder: Path) -> tuple[SceneData, Path]:
    """A small scene with exact masks, and the root of its tree in another layout."""
    data = read_scene(written(folder / "native"))
    export(data, folder / "root", get_renderer("numba"))
    return data, folder / "root"


def hidden_in_first_test_view(folder: Path, *objects: str) -> SceneData:
    """The small scene, with objects that its first test view does not show."""
    given = parts(6)
    first = next(picture for picture in given["pictures"] if picture.masks is not None)
    for name in objects:
        first.masks[name][:] = False
    return read_scene(written(folder, pictures=given["pictures"]))


def assert_same_truth(original: SceneData, read: SceneData, view: str, as_read: str) -> None:
    """A test view has the same camera and, bit for bit, the same masks."""
    given = next(v for v in original.truth.test_views if v.name == view)
    found = next(v for v in read.truth.test_views if v.name == as_read)
    assert_same_camera(given.camera, found.camera)
    for name in OBJECTS:
        expected = original.truth.mask(given, name)
        np.testing.assert_array_equal(read.truth.mask(found, PROMPTS[name]), expected)


def assert_same_camera(given: Camera, found: Camera) -> None:
    assert (found.width, found.height) == (given.width, given.height)
    np.testing.assert_allclose(found.K, given.K, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.world_to_camera, given.world_to_camera, rtol=0, atol=1e-6)


def all_masks(data: SceneData) -> dict[tuple[str, str], np.ndarray]:
    """Every labelled mask, read now: by (view, prompt)."""
    views = {view.name: view for view in data.truth.test_views}
    return {(view, text): data.truth.mask(views[view], text) for view, text in data.truth.masks}


def edit_mask(path: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """Change a mask's grey values, (H, W) uint8."""
    with Image.open(path) as picture:
        grey = np.asarray(picture.convert("L")).copy()
    write_png(path, change(grey))


def save_with_alpha(path: Path, colour: np.ndarray, alpha: np.ndarray) -> None:
    """Write a grey picture with an alpha channel; both (H, W) uint8."""
    Image.fromarray(np.stack([colour, alpha], axis=-1), "LA").save(path)


def save_as_palette(path: Path) -> None:
    """Write a mask again as a picture with a palette: black, and the grey value 255."""
    with Image.open(path) as picture:
        index = (np.asarray(picture.convert("L")) > 127).astype(np.uint8)
    made = Image.fromarray(index, "P")
    made.putpalette([0, 0, 0, 255, 255, 255])
    made.save(path)


def save_in_colour(path: Path) -> None:
    """Write a mask again as RGB."""
    with Image.open(path) as picture:
        colour = picture.convert("RGB")
    colour.save(path)


def save_with_16_bits(path: Path) -> None:
    """Write a mask again with 16 bits a pixel."""
    with Image.open(path) as picture:
        grey = np.asarray(picture.convert("L")).astype(np.uint16) * 257
    Image.fromarray(grey).save(path)


def stretch_pixels(folder: Path, factor: float) -> None:
    """Make every camera's fy that many times its fx."""
    path = folder / "sparse/0/cameras.txt"
    lines = [line.split() for line in path.read_text().splitlines()]
    for words in lines:
        if words[0] != "#":
            words[5] = repr(factor * float(words[4]))
    path.write_text("".join(" ".join(words) + "\n" for words in lines))


def drop_image(folder: Path, name: str) -> None:
    """Take an image out of the COLMAP model; its picture stays."""
    path = folder / "sparse/0/images.txt"
    lines = path.read_text().split("\n")
    (found,) = (i for i, line in enumerate(lines) if line.endswith(f" {name}"))
    path.write_text("\n".join(lines[:found] + lines[found + 2 :]))
