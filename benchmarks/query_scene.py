"""A scene with books made of synthetic patches, and stand-ins for the models that cost nothing.

The Gaussians are those of ``render_scene.surface_scene``: a room with twelve spheres in it. The
cameras stand in the room and look at its middle; their depths are rendered. A view's patches are
the visible parts of the spheres, each whole and in halves, and boxes anywhere for the rest. A
patch of a sphere has a semantic vector near the sphere's own, a box has any.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from render_scene import surface_scene

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
POOL = 512
"""Different boxes."""
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
        """C."""
        return int(self.meanings.shape[1])

    def models(self) -> Models:
        """Itself in all three roles."""
        return Models(self, self, self)

    def encode_texts(self, texts: list[str]) -> NDArray[np.float32]:
        """A vector for each text, near the vector of the sphere that it names."""
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
        """Nobody asks for this."""
        raise NotImplementedError("the books of this benchmark are synthetic")

    def automatic(self, frame: Frame) -> list[Mask]:
        """Nobody asks for this."""
        raise NotImplementedError("the books of this benchmark are synthetic")

    def in_box(self, frame: Frame, box: tuple[float, float, float, float]) -> Mask:
        """Nobody asks for this."""
        raise NotImplementedError("nobody asks for boxes here")

    def at_point(self, frame: Frame, point: tuple[float, float]) -> Mask:
        """A disc around the point."""
        start = time.perf_counter()
        height, width = frame.depth.shape
        rows, columns = np.ogrid[:height, :width]
        radius = height / 10
        mask = Mask((rows - point[1]) ** 2 + (columns - point[0]) ** 2 <= radius**2, 0.9)
        self.seconds += time.perf_counter() - start
        return mask

    def segment(self, frame: Frame, text: str) -> Mask | None:
        """All that is drawn."""
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
    seen = [_visible(camera, depths, i, centres, radii) for i, camera in enumerate(cameras)]
    pool = PatchBook.of_masks([_boxes(rng, width, height)], [(height, width)])
    book, owners = _joined(rng, seen, pool, patches)
    features = rng.normal(size=(len(owners), dim)).astype(np.float32)
    features /= np.linalg.norm(features, axis=1, keepdims=True)
    of_thing = owners >= 0
    features[of_thing] += LIKENESS * meanings[owners[of_thing]].astype(np.float32)
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


def _visible(
    camera: Camera,
    depths: DepthBook,
    view: int,
    centres: NDArray[np.float64],
    radii: NDArray[np.float64],
) -> list[tuple[int, Mask]]:
    """The spheres that a view sees, each whole and in halves."""
    depth = depths.depth(view, "median")
    height, width = depth.shape
    found: list[tuple[int, Mask]] = []
    for thing, (centre, radius) in enumerate(zip(centres, radii, strict=True)):
        (x, y), z = camera.project(centre)
        if z < 1.2 * radius:
            continue
        reach = int(camera.K[0, 0] * radius / (z - radius)) + 2
        x0, y0 = max(0, int(x) - reach), max(0, int(y) - reach)
        part = depth[y0 : max(y0, int(y) + reach), x0 : max(x0, int(x) + reach)]
        columns, rows = np.meshgrid(np.arange(part.shape[1]), np.arange(part.shape[0]))
        points = camera.unproject(np.stack([columns + x0, rows + y0], axis=-1) + 0.5, part)
        away = np.linalg.norm(points - centre, axis=-1)
        pixels = np.zeros((height, width), np.bool_)
        inside = (np.abs(away - radius) < 0.1 * radius) & (part > 0)
        pixels[y0 : y0 + part.shape[0], x0 : x0 + part.shape[1]] = inside
        if np.count_nonzero(inside) < LEAST_AREA:
            continue
        middle = int(np.median(np.flatnonzero(pixels.any(axis=0))))
        left, right = pixels.copy(), pixels.copy()
        left[:, middle:], right[:, :middle] = False, False
        pieces = ((1, pixels), (0, left), (0, right))
        found += [(thing, Mask(piece, 0.9, level)) for level, piece in pieces if piece.any()]
    return found


def _boxes(rng: np.random.Generator, width: int, height: int) -> list[Mask]:
    """Boxes of all sizes, anywhere."""
    masks = []
    for _ in range(POOL):
        size = np.exp(rng.uniform(np.log(10), np.log(min(width, height) / 3), 2)).astype(int)
        x, y = rng.integers(0, (width - size[0], height - size[1]))
        pixels = np.zeros((height, width), np.bool_)
        pixels[y : y + size[1], x : x + size[0]] = True
        masks.append(Mask(pixels, 0.5, int(rng.integers(0, 3))))
    return masks


def _joined(
    rng: np.random.Generator, seen: list[list[tuple[int, Mask]]], pool: PatchBook, count: int
) -> tuple[PatchBook, NDArray[np.int64]]:
    """The book of every view's spheres and of boxes out of the pool, and each patch's sphere."""
    size = (int(pool.sizes[0, 0]), int(pool.sizes[0, 1]))
    own = PatchBook.of_masks(
        [[mask for _, mask in view[:count]] for view in seen], [size] * len(seen)
    )
    things = [thing for view in seen for thing, _ in view[:count]]
    books, rows, owners = [], [], []
    for i in range(len(seen)):
        first, last = int(own.view_ptr[i]), int(own.view_ptr[i + 1])
        boxes = rng.integers(0, POOL, count - (last - first))
        books += [own] * (last - first) + [pool] * len(boxes)
        rows += [*range(first, last), *boxes.tolist()]
        owners += [*things[first:last], *[-1] * len(boxes)]
    chosen = list(zip(books, rows, strict=True))
    runs = [book.rle[book.rle_ptr[row] : book.rle_ptr[row + 1]] for book, row in chosen]
    return PatchBook(
        view_ptr=np.arange(len(seen) + 1, dtype=np.int64) * count,
        rle=np.concatenate(runs),
        rle_ptr=np.cumsum([0, *(len(run) for run in runs)], dtype=np.int64),
        boxes=np.stack([book.boxes[row] for book, row in chosen]),
        areas=np.array([book.areas[row] for book, row in chosen], np.int32),
        levels=np.array([book.levels[row] for book, row in chosen], np.int16),
        scores=np.array([book.scores[row] for book, row in chosen], np.float32),
        sizes=np.array([size] * len(seen), np.int32),
    ), np.array(owners, np.int64)
