"""How the time of a method grows with Gaussians, views and queries.

The scene is the room of ``render_speed.py`` with six of its spheres as objects, seen by cameras
that stand in it. The models are oracles: they know the truth, cost a few renders, and leave the
project's own work: rendering, books, localising, lifting, segmenting. Times of the onboard models
or of networks come on top, and grow with views (patches, features) or queries (text masks) alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from measuring import Line, Spread, straight_fit
from render_scene import surface_scene

from gvr_core.books import Books
from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.methods import Method, MethodConfig, Toolbox, build_method
from gvr_core.models.oracle import OracleWorld, oracle_models
from gvr_core.rendering.numba_renderer import NumbaRenderer
from gvr_core.scene import Query, Scene, View

OBJECTS = tuple(f"sphere {i}" for i in range(6))
METHODS = ("gvr-paper", "gvr-robust", "lift")
WIDTH, HEIGHT = 320, 240


@dataclass(frozen=True)
class Growth:
    """Seconds at several sizes, and the line through them."""

    what: str
    """What takes the time, e.g. ``"gvr-paper: prepare"``."""
    of: str
    """What grows."""
    points: tuple[tuple[int, Spread], ...]

    @property
    def fit(self) -> Line:
        """The straight line through the medians."""
        return straight_fit(
            [size for size, _ in self.points], [spread.median for _, spread in self.points]
        )


@dataclass(frozen=True)
class MethodTimes:
    """One method on one scene."""

    method: str
    prepare: Spread
    """Seconds, books and index."""
    query: Spread
    """Seconds of each query."""


def room(gaussians: int, views: int) -> tuple[Scene, OracleWorld]:
    """The scene of the module's description, and its truth.

    Args:
        gaussians: How many.
        views: How many cameras.
    """
    drawn = surface_scene(gaussians)
    rng = np.random.default_rng(0)  # as surface_scene draws its spheres
    centres, radii = (rng.random((12, 3)) - 0.5) * [4.2, 2.8, 2.1], rng.uniform(0.2, 0.5, 12)
    away = np.stack(
        [
            np.abs(np.linalg.norm(drawn.means - c, axis=1) - r)
            for c, r in zip(centres, radii, strict=True)
        ],
        axis=1,
    )
    nearest = away.argmin(axis=1)
    labels = np.where((away.min(axis=1) < 1e-4) & (nearest < len(OBJECTS)), nearest, -1)
    cameras = [_camera(np.random.default_rng(i)) for i in range(views)]
    named = tuple(View(f"v{i:04d}", camera) for i, camera in enumerate(cameras))
    scene = Scene("benchmark", "room", drawn, named, np.array([0.0, 0.0, 1.0]))
    meanings = {f"the {name}": name for name in OBJECTS}
    return scene, OracleWorld(drawn, labels.astype(np.int16), OBJECTS, meanings)


def queries(count: int) -> list[Query]:
    """Questions for the spheres in turn."""
    return [
        Query(id=f"q{i}", text=f"the {OBJECTS[i % len(OBJECTS)]}", target=OBJECTS[i % len(OBJECTS)])
        for i in range(count)
    ]


def method_times(
    gaussians: int, views: int, asked: int, repeats: int, names: Sequence[str] = METHODS
) -> list[MethodTimes]:
    """Preparation and queries of some methods on the same room, in turns.

    Args:
        gaussians: How many.
        views: How many.
        asked: Queries that are timed, after one that is not.
        repeats: Of the preparation.
        names: The methods.
    """
    scene, world = room(gaussians, views)
    methods = {name: _method(name, world) for name in names}
    prepared: dict[str, list[float]] = {name: [] for name in names}
    books: dict[str, Books] = {}
    for _ in range(repeats):
        for name, method in methods.items():
            start = time.perf_counter()
            books[name] = method.prepare(scene)
            prepared[name].append(time.perf_counter() - start)
    answered = {name: _each(methods[name], scene, books[name], asked) for name in names}
    return [
        MethodTimes(name, Spread.of(prepared[name]), Spread.of(answered[name])) for name in names
    ]


def with_views(method: str, counts: Sequence[int], gaussians: int, repeats: int) -> list[Growth]:
    """Preparation and queries with more and more views."""
    prepare, query = [], []
    for count in counts:
        (times,) = method_times(gaussians, count, 6, repeats, [method])
        prepare.append((count, times.prepare))
        query.append((count, times.query))
    return [
        Growth(f"{method}: prepare", "views", tuple(prepare)),
        Growth(f"{method}: a query", "views", tuple(query)),
    ]


def with_gaussians(method: str, counts: Sequence[int], views: int, repeats: int) -> list[Growth]:
    """Preparation and queries with more and more Gaussians."""
    prepare, query = [], []
    for count in counts:
        (times,) = method_times(count, views, 6, repeats, [method])
        prepare.append((count, times.prepare))
        query.append((count, times.query))
    return [
        Growth(f"{method}: prepare", "Gaussians", tuple(prepare)),
        Growth(f"{method}: a query", "Gaussians", tuple(query)),
    ]


def with_queries(
    method: str, counts: Sequence[int], gaussians: int, views: int, repeats: int
) -> Growth:
    """All the queries of one scene, more and more of them."""
    scene, world = room(gaussians, views)
    ways = _method(method, world)
    books = ways.prepare(scene)
    _each(ways, scene, books, 1)
    totals: dict[int, list[float]] = {count: [] for count in counts}
    for _ in range(repeats):
        spent = np.cumsum(_each(ways, scene, books, max(counts), warm=0))
        for count in counts:
            totals[count].append(float(spent[count - 1]))
    points = tuple((count, Spread.of(totals[count])) for count in counts)
    return Growth(f"{method}: all queries", "queries", points)


def profiled(method: str, gaussians: int, views: int, asked: int) -> Callable[[], None]:
    """A whole scene as work to be profiled: preparation, then queries."""
    scene, world = room(gaussians, views)
    ways = _method(method, world)

    def work() -> None:
        books = ways.prepare(scene)
        for query in queries(asked):
            ways.ground(scene, books, query)

    return work


def _each(method: Method, scene: Scene, books: Books, count: int, warm: int = 1) -> list[float]:
    """Seconds of each of so many queries, after some that do not count."""
    times = []
    for query in [*queries(warm), *queries(count)]:
        start = time.perf_counter()
        method.ground(scene, books, query)
        times.append(time.perf_counter() - start)
    return times[warm:]


def _method(name: str, world: OracleWorld) -> Method:
    tools = Toolbox(NumbaRenderer(), oracle_models(world))
    return build_method(MethodConfig(method=name), tools)


def _camera(rng: np.random.Generator) -> Camera:
    """Somewhere in the upper half of the room, not too near its middle."""
    angle = rng.uniform(0, 2 * np.pi)
    eye = np.array([2.6 * np.cos(angle), 1.7 * np.sin(angle), rng.uniform(0.3, 1.3)])
    target = rng.normal(0, 0.4, 3) - [0, 0, 0.4]
    return Camera(intrinsics(60, WIDTH, HEIGHT), look_at(eye, target, (0, 0, 1)), WIDTH, HEIGHT)
