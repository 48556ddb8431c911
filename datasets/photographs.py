"""Real photographs and textures that installed packages carry, readable without a network.

One table for everything that the gallery shows: where a photograph comes from, under which
licence, which part is used, what it is called, and how people might ask for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

RGB8 = NDArray[np.uint8]


@dataclass(frozen=True)
class Photograph:
    """One photograph, and the object that it stands for."""

    name: str
    """Name of the object; also its file name in a scene's masks."""
    source: str
    """``package:picture`` to read it from."""
    crop: tuple[int, int, int, int]
    """The part that is used: left, top, right, bottom, pixels."""
    wordings: tuple[str, ...]
    """Queries that mean it: two or more."""
    licence: str
    """Who took it, and how it may be used."""


PHOTOGRAPHS = (
    Photograph(
        "cat",
        "skimage:chelsea",
        (0, 0, 390, 300),
        ("a cat", "the face of a tabby kitten"),
        "CC0, Stefan van der Walt",
    ),
    Photograph(
        "cup of coffee",
        "skimage:coffee",
        (70, 0, 530, 400),
        ("a cup of coffee", "an espresso in a red cup with a saucer"),
        "CC0, Rachel Michetti, courtesy of Pikolo Espresso Bar",
    ),
    Photograph(
        "rocket",
        "skimage:rocket",
        (210, 80, 440, 427),
        ("a rocket", "a missile standing on its launch pad at night"),
        "public domain, SpaceX: Falcon 9 with DSCOVR",
    ),
    Photograph(
        "astronaut",
        # the right edge is left out: a model of a space shuttle stands there
        "skimage:astronaut",
        (20, 0, 350, 400),
        ("an astronaut", "a woman in an orange space suit"),
        "public domain, NASA: Eileen Collins",
    ),
    Photograph(
        "coins",
        "skimage:coins",
        (10, 10, 374, 293),
        ("old coins", "rows of ancient silver money"),
        "no known restrictions, Brooklyn Museum: Greek coins from Pompeii",
    ),
    Photograph(
        "galaxies",
        "skimage:hubble_deep_field",
        (250, 200, 750, 600),
        ("galaxies", "many stars in the night sky"),
        "public domain, NASA and HubbleSite: Hubble eXtreme Deep Field",
    ),
    Photograph(
        "cameraman",
        "skimage:camera",
        (0, 40, 400, 512),
        ("a camera on a tripod", "a photographer in a black coat"),
        "CC0, Lav Varshney",
    ),
    Photograph(
        "motorcycle",
        "skimage:stereo_motorcycle",
        (80, 80, 700, 490),
        ("a motorcycle", "a red motor bike with two wheels"),
        "Nesic, Westling, Wang, Kitajima, Krathwohl, Scharstein: Middlebury 2014 stereo benchmark",
    ),
    Photograph(
        "flower",
        "sklearn:flower.jpg",
        (115, 50, 500, 370),
        ("a flower", "an orange blossom with many petals"),
        "CC BY 2.0, vultilion (flickr.com/photos/vultilion)",
    ),
    Photograph(
        "temple",
        "sklearn:china.jpg",
        (40, 10, 390, 410),
        ("a chinese temple", "a pagoda with curved roofs"),
        "CC BY 2.0, danielbuechele (flickr.com/photos/danielbuechele)",
    ),
    Photograph(
        "officer",
        "matplotlib:grace_hopper.jpg",
        (60, 0, 490, 560),
        ("a navy officer", "an old woman in a military uniform"),
        "public domain, United States Navy: Grace Hopper",
    ),
)

TEXTURES = ("brick", "grass", "gravel")
"""Grey textures of scikit-image, all CC0."""


def read_photograph(photograph: Photograph) -> RGB8:
    """The used part of a photograph.

    Returns:
        (H, W, 3) uint8.
    """
    picture = Image.fromarray(_read(photograph.source)).convert("RGB")
    return np.asarray(picture.crop(photograph.crop))


def read_texture(name: str, tint: tuple[float, float, float], contrast: float = 1.0) -> RGB8:
    """A grey texture in a colour.

    Args:
        name: One of `TEXTURES`.
        tint: Mean colour, each channel in [0, 1].
        contrast: Factor on the texture's own variation around its mean.

    Returns:
        (512, 512, 3) uint8.
    """
    grey = _read(f"skimage:{name}").astype(np.float64)
    if name == "brick":
        grey = grey.T  # the courses run from top to bottom in the picture
    relative = 1 + contrast * (grey / grey.mean() - 1)
    return _to_bytes(relative[..., None] * np.asarray(tint))


def wood(rng: np.random.Generator, tint: tuple[float, float, float]) -> RGB8:
    """A procedural board of wood: rings of a wavy trunk, cut lengthwise.

    Args:
        rng: Where the waves come from.
        tint: Mean colour, each channel in [0, 1].

    Returns:
        (384, 512, 3) uint8.
    """
    y, x = np.mgrid[0:384, 0:512] / 384.0
    waves = sum(
        rng.uniform(0.3, 1)
        / k
        * np.sin(k * (rng.uniform(1, 2) * x + rng.uniform(2, 5) * y) + phase)
        for k, phase in enumerate(rng.uniform(0, 2 * np.pi, 5), start=1)
    )
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (9 * y + 0.5 * waves))
    boards = 1 + 0.08 * np.sin(12.9898 * np.floor(5 * y) + 1)
    seam = np.where((5 * y) % 1 < 0.03, 0.55, 1.0)
    shade = (0.82 + 0.3 * rings) * boards * seam * rng.normal(1, 0.03, y.shape)
    return _to_bytes(shade[..., None] * np.asarray(tint))


def _to_bytes(colours: NDArray[np.float64]) -> RGB8:
    """Colours in [0, 1] as bytes; what lies outside is clipped."""
    pixels: RGB8 = np.rint(255 * np.clip(colours, 0, 1)).astype(np.uint8)
    return pixels


def _read(source: str) -> NDArray[np.uint8]:
    """A whole picture by its source: (H, W) or (H, W, 3) uint8."""
    package, _, name = source.partition(":")
    # imported here: together they take seconds, and only making a scene needs them
    if package == "sklearn":
        from sklearn.datasets import load_sample_image

        return np.asarray(load_sample_image(name))
    if package == "matplotlib":
        import matplotlib

        path = Path(matplotlib.get_data_path()) / "sample_data" / name
        with Image.open(path) as picture:
            return np.asarray(picture.convert("RGB"))
    import skimage.data

    read = getattr(skimage.data, name)()
    return np.asarray(read[0] if isinstance(read, tuple) else read)
