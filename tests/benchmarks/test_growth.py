"""The scene that grows, and what is measured on it."""

from __future__ import annotations

import numpy as np
import pytest
from growth import OBJECTS, Growth, method_times, queries, room, with_queries, with_views
from measuring import Spread


def test_the_room_holds_its_objects() -> None:
    scene, world = room(6000, 3)
    counts = np.bincount(world.labels + 1, minlength=len(OBJECTS) + 1)
    assert len(scene.views) == 3
    assert counts[0] > 3000  # the walls and the other spheres
    assert (counts[1:] > 100).all()
    chosen = scene.gaussians.means[world.labels == 0]
    middle = (chosen.min(axis=0) + chosen.max(axis=0)) / 2
    radii = np.linalg.norm(chosen - middle, axis=1)
    assert radii.std() < 0.1 * radii.mean()
    assert {query.target for query in queries(7)} == set(OBJECTS)
    assert world.meaning(queries(2)[1].text) == 1


def test_growth_is_measured_at_every_size() -> None:
    (times,) = method_times(3000, 2, 3, 2, ["lift"])
    assert (times.method, times.prepare.repeats, times.query.repeats) == ("lift", 2, 3)
    grown = with_queries("lift", (1, 2, 5), 3000, 2, 2)
    medians = [spread.median for _, spread in grown.points]
    assert [size for size, _ in grown.points] == [1, 2, 5]
    assert medians == sorted(medians)
    prepare, query = with_views("lift", (2, 4), 3000, 1)
    assert (prepare.of, [size for size, _ in query.points]) == ("views", [2, 4])


def test_a_growth_has_its_line() -> None:
    points = tuple((size, Spread.of([0.1 + 0.5 * size])) for size in (1, 2, 8))
    assert Growth("x", "views", points).fit.slope == pytest.approx(0.5)
