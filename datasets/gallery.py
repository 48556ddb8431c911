"""The gallery: real photographs on boxes and cards, on a table, with exact labels and masks.

It needs nothing but installed packages, and is the same on every machine: a seed decides what
stands where. The photographs are real, the arrangement is synthetic; reports have to say so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.arrangement import Item, arrange
from datasets.base import SceneData
from datasets.making import RENDERER, made_once, orbit_camera, recipe_digest, slug, take_pictures
from datasets.native import read_scene, write_scene
from datasets.photographs import PHOTOGRAPHS, Photograph, read_photograph, read_texture, wood
from datasets.surfaces import box, rectangle
from gvr_core.cameras import Camera
from gvr_core.errors import unknown_name
from gvr_core.gaussians import Gaussians
from gvr_core.rendering.base import get_renderer
from gvr_core.scene import Query
from gvr_core.transforms import transform_gaussians

VERSION = 1
"""Raised whenever the same seed makes another scene."""

SIZE = (480, 360)
"""Width and height of the pictures, pixels."""
FOV_DEGREES = 52.0
TARGET = (0.0, 0.0, 0.12)
"""What the cameras look at, scene units; the things are 0.3 to 0.5 tall."""
ITEM_GAUSSIANS = 80_000
"""About as many Gaussians make up the things; the table and the wall come on top."""

ABSENT = (
    "a zebra",
    "a bunch of bananas",
    "a school bus",
    "an umbrella",
    "a goldfish in a bowl",
    "a grand piano",
    "a bowl of strawberries",
    "a pair of sunglasses",
)
"""Things that ImageNet has a class for and no photograph shows."""


@dataclass(frozen=True)
class GalleryScene:
    """One scene before it is drawn."""

    gaussians: Gaussians
    labels: NDArray[np.int16]
    """(N,) index into ``objects``, -1 for the table and the wall."""
    objects: tuple[str, ...]
    cameras: dict[str, Camera]
    test_views: tuple[str, ...]
    queries: tuple[Query, ...]


class GalleryDataset:
    """Scenes ``gallery_<seed>``, made on first use.

    Args:
        root: Folder to keep them in; a scene is made again when the generator's version changes.
        seeds: One scene for each.
    """

    name = "gallery"

    def __init__(
        self, root: Path = Path(".gvr/data/gallery"), seeds: Sequence[int] = (0, 1, 2, 3)
    ) -> None:
        self._root = root
        self._seeds = {f"gallery_{seed}": seed for seed in seeds}

    def scenes(self) -> Sequence[str]:
        """Names of the scenes, in the order of the seeds."""
        return tuple(self._seeds)

    def load(self, scene: str) -> SceneData:
        """Read one scene; the first time, make it.

        Raises:
            ConfigError: for a scene that is not among the seeds.
            DatasetError: if the folder on disk is damaged.
        """
        if scene not in self._seeds:
            raise unknown_name("scene of gallery", scene, self._seeds)
        seed = self._seeds[scene]
        folder = self._root / scene
        renderer = get_renderer(RENDERER)
        recipe = recipe_digest("gallery", VERSION, renderer.name, seed)
        made_once(folder, recipe, lambda: make_scene(folder, scene, seed, recipe))
        return read_scene(folder, self.name, scene)


def make_scene(folder: Path, name: str, seed: int, recipe: str = "") -> None:
    """Make one scene on disk, in the native layout.

    Args:
        folder: Where; an older scene there is replaced.
        name: The scene's name.
        seed: Decides what stands where.
        recipe: Kept in the scene, to tell whether it is up to date.
    """
    made = compose(seed)
    write_scene(
        folder,
        dataset="gallery",
        name=name,
        gaussians=made.gaussians,
        pictures=take_pictures(
            get_renderer(RENDERER),
            made.gaussians,
            made.labels,
            made.objects,
            made.cameras,
            made.test_views,
        ),
        objects=made.objects,
        labels=made.labels,
        queries=made.queries,
        up=(0.0, 0.0, 1.0),
        provenance=_provenance(made.objects),
        recipe=recipe,
        replace=True,
    )


def compose(seed: int) -> GalleryScene:
    """Everything of a scene but its pictures: the same seed, the same numbers.

    Args:
        seed: Not negative.
    """
    rng = np.random.default_rng(seed)
    chosen = _deal(seed)
    pictures = {photo.name: read_photograph(photo) for photo in chosen}
    boxed = 2 + int(rng.integers(0, 2))
    items = [
        _item(rng, photo, pictures[photo.name], is_box=i < boxed, lies=i == len(chosen) - 1)
        for i, photo in enumerate(chosen)
    ]
    cameras, test_views = _cameras()
    places = arrange(rng, items, list(cameras.values())[::3])
    pitch = float(np.sqrt(sum(_area(item) for item in items) / ITEM_GAUSSIANS))
    rim = np.full((8, 8, 3), 225, np.uint8)
    parts, labels = [], []
    for index, (item, place) in enumerate(zip(items, places, strict=True)):
        part = box(item.size, pictures[item.name], None if item.boxed else rim, pitch)
        corners = item.corners()
        part = transform_gaussians(part, item.rotation)
        drop = part.means[:, 2].min() - corners[:, 2].min()
        middle = (part.means.min(axis=0) + part.means.max(axis=0)) / 2
        move = (place[0] - middle[0], place[1] - middle[1], -drop + pitch / 2)
        parts.append(transform_gaussians(part, translation=move))
        labels.append(np.full(len(part), index, np.int16))
    room = _room(rng)
    gaussians = Gaussians.concatenate([*parts, room])
    labels.append(np.full(len(room), -1, np.int16))
    return GalleryScene(
        gaussians,
        np.concatenate(labels),
        tuple(item.name for item in items),
        cameras,
        test_views,
        _queries(rng, chosen),
    )


def _deal(seed: int) -> list[Photograph]:
    """Five or six photographs; two neighbouring seeds share the whole pack between them."""
    order = np.random.default_rng((seed // 2, 11)).permutation(len(PHOTOGRAPHS))
    half = order[:5] if seed % 2 == 0 else order[5:]
    return [PHOTOGRAPHS[i] for i in half]


def _item(
    rng: np.random.Generator,
    photo: Photograph,
    picture: NDArray[np.uint8],
    is_box: bool,
    lies: bool,
) -> Item:
    """A box, a standing card or a lying card, in the shape of its photograph."""
    root_aspect = float(np.sqrt(picture.shape[1] / picture.shape[0]))
    edge = float(rng.uniform(0.36, 0.44))
    width, height = edge * root_aspect, edge / root_aspect
    yaw = float(rng.uniform(-25, 25))
    if is_box:
        return Item(photo.name, (width, 0.6 * width, height), 0.0, yaw, True)
    lean = 90.0 if lies else float(rng.uniform(8, 18))
    return Item(photo.name, (1.1 * width, 0.025, 1.1 * height), lean, yaw, False)


def _area(item: Item) -> float:
    """Surface of a thing that Gaussians cover."""
    w, d, h = item.size
    return 2 * w * h + 2 * d * h + w * d


def _room(rng: np.random.Generator) -> Gaussians:
    """The table top at z = 0 and the wall behind it."""
    tints = ((0.55, 0.40, 0.26), (0.42, 0.30, 0.22), (0.62, 0.52, 0.40), (0.50, 0.50, 0.46))
    tint = tints[int(rng.integers(len(tints)))]
    kind = int(rng.integers(3))
    table = wood(rng, tint) if kind < 2 else read_texture("gravel", tint, 0.45)
    wall_tints = ((0.62, 0.44, 0.36), (0.55, 0.58, 0.60), (0.66, 0.62, 0.52))
    wall = read_texture("brick", wall_tints[int(rng.integers(len(wall_tints)))], 0.6)
    x, y, z = np.eye(3)
    return Gaussians.concatenate(
        [
            rectangle((-1.9, 0.85, 0), 3.8 * x, -2.45 * y, table, 0.02),
            rectangle((-1.9, 0.85, 1.2), 3.8 * x, -1.2 * z, wall, 0.022),
        ]
    )


def _cameras() -> tuple[dict[str, Camera], tuple[str, ...]]:
    """24 knowledge views in three rows over the front, and 4 test views at angles in between."""
    poses: dict[str, tuple[float, float, float]] = {}
    for row, (pitch, radius) in enumerate(((20.0, 2.6), (34.0, 2.5), (50.0, 2.5))):
        for column in range(8):
            yaw = -56 + 16 * column + (0, 5, -5)[row]
            poses[f"view_{8 * row + column:03d}"] = (radius, yaw, pitch)
    tests = ((2.5, -38.0, 27.0), (2.55, -11.0, 42.0), (2.6, 15.0, 25.0), (2.45, 43.0, 40.0))
    poses.update({f"test_{i}": pose for i, pose in enumerate(tests)})
    cameras = {n: orbit_camera(TARGET, *pose, SIZE, FOV_DEGREES) for n, pose in poses.items()}
    return cameras, tuple(name for name in poses if name.startswith("test_"))


def _queries(rng: np.random.Generator, chosen: Sequence[Photograph]) -> tuple[Query, ...]:
    """Every wording of every object, and one thing that is not there."""
    queries = [
        Query(id=f"{slug(photo.name)}-{i}", text=text, target=photo.name)
        for photo in chosen
        for i, text in enumerate(photo.wordings, start=1)
    ]
    missing = ABSENT[int(rng.integers(len(ABSENT)))]
    return (*queries, Query(id="absent-1", text=missing, absent=True))


def _provenance(objects: Sequence[str]) -> str:
    """Whose photographs the scene shows."""
    sources = "; ".join(
        f"{p.name}: {p.source}, {p.licence}" for p in PHOTOGRAPHS if p.name in objects
    )
    return f"synthetic arrangement of real photographs. {sources}"
