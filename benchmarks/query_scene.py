"""A scene with books made of synthetic patches, and stand-ins for the models that cost nothing.

The Gaussians are those of ``render_speed.surface_scene``: a room with twelve spheres in it. The
cameras stand in the room and look at its middle; their depths are rendered. A view's patches are
the visible parts of the spheres, each whole and in halves, and boxes anywhere for the rest. A
patch of a sphere has a semantic vector near the sphere's own, a box has any.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from render_speed import surface_scene

from gvr_core.books import Books, DepthBook, PatchBook, SemanticVectorBook, ViewBook
from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.models.base import Frame, Mask, Models
from gvr_core.preparation import render_depths
from gvr_core.rendering.numba_renderer import NumbaRenderer
from gvr_core.scene import Query, Scene, View

THINGS = 12
"""Spheres in the room."""
LIKENESS = 0.4
"""Part of a sphere's own vector in those of its patches; the rest is noise."""
LEAST_AREA = 60
"""Pixels of the smallest patch of a sphere."""


@dataclass
class StandIns:
    """What the benchmark has in the place of the three models, and the time spent in it.

    A text means the sphere whose number it ends with; the mask at a point is a disc around it;
    a text mask is all that is drawn. None of them looks at the picture.
    """

    meanings: NDArray[np.float32]
    """(things, c) vector of each sphere."""
    seconds: float = 0.0
    """Time spent here since it was last set to 0."""
    name: str = "stand-in-of-the-benchmark"
    _known: dict[str, NDArray[np.float32]] = field(default_factory=dict)

    @property
    def dim(self) -> int:
        return int(self.meanings.shape[1])

    def models(self) -> Models:
        return Models(self, self, self)

    def encode_texts(self, texts: list[str]) -> NDArray[np.float32]:
        start = time.perf_counter()
        for text in texts:
            if text not in self._known:
                self._known[text] = self._vector(text)
        vectors = np.stack([self._known[text] for text in texts])
        self.seconds += time.perf_counter() - start
        return vectors

    def _vector(self, text: str) -> NDArray[np.float32]:
        rng = np.random.default_rng(list(text.encode()))
        noise = rng.normal(size=self.dim) / np.sqrt(self.dim)
        number = text.rpartition(" ")[2]
        known = self.meanings[int(number) % THINGS] if number.isdigit() else 0
        vector = known + 0.3 * noise
        return (vector / np.linalg.norm(vector)).astype(np.float32)

    def encode_patches(self, frame: Frame, masks: list[Mask]) -> NDArray[np.float32]:
        raise NotImplementedError("the books of this benchmark are synthetic")

    def automatic(self, frame: Frame) -> list[Mask]:
        raise NotImplementedError("the books of this benchmark are synthetic")

    def in_box(self, frame: Frame, box: tuple[float, float, float, float]) -> Mask:
        raise NotImplementedError("nobody asks for boxes here")

    def at_point(self, frame: Frame, point: tuple[float, float]) -> Mask:
        start = time.perf_counter()
        height, width = frame.depth.shape
        rows, columns = np.ogrid[:height, :width]
        radius = height / 10
        mask = Mask((rows - point[1]) ** 2 + (columns - point[0]) ** 2 <= radius**2, 0.9)
        self.seconds += time.perf_counter() - start
        return mask

    def segment(self, frame: Frame, text: str) -> Mask | None:
        start = time.perf_counter()
        mask = Mask(frame.alpha > 0.5, 0.8) if frame.alpha is not None else None
        self.seconds += time.perf_counter() - start
        return mask


@dataclass(frozen=True, eq=False)
class QueryScene:
    """All that a query needs."""

    scene: Scene
    books: Books
    stand_ins: StandIns
    queries: tuple[Query, ...]


def query_scene(
    gaussians: int = 200_000,
    views: int = 300,
    patches: int = 100,
    width: int = 640,
    height: int = 480,
    queries: int = 50,
    dim: int = 512,
    seed: int = 0,
) -> QueryScene:
    """The scene of the module's description.

    Args:
        gaussians: How many.
        views: n, the knowledge views.
        patches: Of each view.
        width: Of a picture, pixels.
        height: Of a picture, pixels.
        queries: How many; they ask for the spheres in turn.
        dim: c, length of a semantic vector.
        seed: Of all random numbers.
    """
    rng = np.random.default_rng(seed)
    drawn = surface_scene(gaussians, seed)
    centres, radii = spheres(seed)
    cameras = [_camera(rng, width, height) for _ in range(views)]
    named = tuple(View(f"v{i:04d}", camera) for i, camera in enumerate(cameras))
    depths = render_depths(drawn, named, NumbaRenderer())
    meanings = rng.normal(size=(THINGS, dim))
    meanings /= np.linalg.norm(meanings, axis=1, keepdims=True)
    masks, owners = [], []
    for i, camera in enumerate(cameras):
        own, things = _patches(rng, camera, depths, i, centres, radii, patches)
        masks.append(own)
        owners += things
    book = PatchBook.of_masks(masks, [(height, width)] * views)
    features = rng.normal(size=(len(owners), dim)).astype(np.float32)
    features /= np.linalg.norm(features, axis=1, keepdims=True)
    of_thing = np.array(owners) >= 0
    features[of_thing] += LIKENESS * meanings[np.array(owners)[of_thing]].astype(np.float32)
    features /= np.linalg.norm(features, axis=1, keepdims=True)
    blank = ViewBook(np.zeros((0, 3), np.uint8), np.zeros(0, np.uint8), np.zeros((0, 2), np.int32))
    books = Books(blank, depths, SemanticVectorBook(features, book))
    asked = tuple(
        Query(id=f"q{i}", text=f"number {i} of thing {i % THINGS}") for i in range(queries)
    )
    scene = Scene("benchmark", "room", drawn, named)
    return QueryScene(scene, books, StandIns(meanings.astype(np.float32)), asked)


def spheres(seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres (12, 3) and radii (12,) of the spheres, as ``surface_scene`` draws them."""
    rng = np.random.default_rng(seed)
    return (rng.random((THINGS, 3)) - 0.5) * [4.2, 2.8, 2.1], rng.uniform(0.2, 0.5, THINGS)


def _camera(rng: np.random.Generator, width: int, height: int) -> Camera:
    """Somewhere in the upper half of the room, not too near its middle."""
    angle = rng.uniform(0, 2 * np.pi)
    eye = np.array([2.6 * np.cos(angle), 1.7 * np.sin(angle), rng.uniform(0.3, 1.3)])
    target = rng.normal(0, 0.4, 3) - [0, 0, 0.4]
    return Camera(intrinsics(60, width, height), look_at(eye, target, (0, 0, 1)), width, height)


def _patches(
    rng: np.random.Generator,
    camera: Camera,
    depths: DepthBook,
    view: int,
    centres: NDArray[np.float64],
    radii: NDArray[np.float64],
    count: int,
) -> tuple[list[Mask], list[int]]:
    """A view's patches, and the sphere that each shows, -1 for none."""
    depth = depths.depth(view, "median")
    height, width = depth.shape
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    points = camera.unproject(np.stack([x, y], axis=-1), depth).astype(np.float32)
    masks: list[Mask] = []
    owners: list[int] = []
    for thing, (centre, radius) in enumerate(zip(centres, radii, strict=True)):
        away = np.linalg.norm(points - centre.astype(np.float32), axis=-1)
        pixels = (np.abs(away - radius) < 0.1 * radius) & (depth > 0)
        if np.count_nonzero(pixels) < LEAST_AREA:
            continue
        middle = int(np.median(np.flatnonzero(pixels.any(axis=0))))
        left, right = pixels.copy(), pixels.copy()
        left[:, middle:], right[:, :middle] = False, False
        for level, part in ((1, pixels), (0, left), (0, right)):
            if part.any() and len(masks) < count:
                masks.append(Mask(part, 0.9, level))
                owners.append(thing)
    while len(masks) < count:
        size = np.exp(rng.uniform(np.log(10), np.log(160), 2)).astype(int)
        corner = rng.integers(0, (width - size[0], height - size[1]))
        pixels = np.zeros((height, width), np.bool_)
        pixels[corner[1] : corner[1] + size[1], corner[0] : corner[0] + size[0]] = True
        masks.append(Mask(pixels, 0.5, int(rng.integers(0, 3))))
        owners.append(-1)
    return masks, owners
