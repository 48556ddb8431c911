"""The hand-drawn outlines can be trusted to judge a model: right picture, proper polygons."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import skimage.data
from numpy.typing import NDArray
from outlines import Outline, photograph, read_outlines

DRAWN = read_outlines()
each = pytest.mark.parametrize("outline", DRAWN, ids=lambda outline: outline.thing)


def enclosed(polygon: NDArray[np.float64]) -> float:
    """Area of a polygon by its vertices alone, pixels."""
    x, y = polygon.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def edges(polygon: NDArray[np.float64]) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    return list(zip(polygon, np.roll(polygon, -1, axis=0), strict=True))


def side(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> float:
    """Positive, zero or negative: on which side of the line from a to b the point c lies."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def crossings(polygon: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Pairs of edges that are no neighbours, and yet meet."""
    around = edges(polygon)
    found = []
    for (i, (a, b)), (j, (c, d)) in combinations(enumerate(around), 2):
        if j - i in (1, len(around) - 1):
            continue
        # edges that lie apart on one line have all four sides 0: their boxes tell
        apart = (np.maximum(a, b) < np.minimum(c, d)) | (np.maximum(c, d) < np.minimum(a, b))
        if apart.any():
            continue
        if side(a, b, c) * side(a, b, d) <= 0 and side(c, d, a) * side(c, d, b) <= 0:
            found.append((i, j))
    return found


def distance(point: tuple[float, float], polygon: NDArray[np.float64]) -> float:
    """From a point to the nearest edge, pixels."""
    p = np.asarray(point)
    nearest = np.inf
    for a, b in edges(polygon):
        along = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        nearest = min(nearest, float(np.linalg.norm(a + along * (b - a) - p)))
    return nearest


def test_what_is_drawn() -> None:
    assert [(outline.picture, outline.thing) for outline in DRAWN] == [
        ("coffee", "spoon"),
        ("coffee", "cup"),
        ("cat", "cat"),
        ("astronaut", "helmet"),
    ]


@each
def test_the_photograph_is_the_one_it_was_drawn_on(outline: Outline) -> None:
    pixels = photograph(outline)
    assert pixels.dtype == np.uint8
    assert pixels.shape[:2] == outline.mask.shape


def test_another_picture_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    other = skimage.data.coffee().copy()
    other[200, 300, 1] ^= 1
    monkeypatch.setattr(skimage.data, "coffee", lambda: other)
    with pytest.raises(ValueError, match="not the photograph"):
        photograph(DRAWN[0])


@each
def test_it_lies_inside_the_picture(outline: Outline) -> None:
    for polygon in outline.polygons:
        assert (polygon >= 0).all()
        assert (polygon <= [outline.width, outline.height]).all()


@each
def test_its_polygons_are_simple(outline: Outline) -> None:
    for polygon in outline.polygons:
        assert len(polygon) >= 20
        assert len(np.unique(polygon, axis=0)) == len(polygon)
        assert crossings(polygon) == []


def test_a_polygon_that_crosses_itself_is_seen() -> None:
    bow = np.array([[0.0, 0.0], [4.0, 4.0], [4.0, 0.0], [0.0, 4.0]])
    assert crossings(bow) == [(0, 2)]


@each
def test_its_area_is_the_polygons_own_and_sane(outline: Outline) -> None:
    area = int(outline.mask.sum())
    assert area == pytest.approx(sum(map(enclosed, outline.polygons)), rel=0.01)
    smallest, largest = {
        "spoon": (0.02, 0.04),
        "cup": (0.15, 0.30),
        "cat": (0.60, 0.85),
        "helmet": (0.08, 0.15),
    }[outline.thing]
    assert smallest <= area / outline.mask.size <= largest


@each
def test_its_point_lies_well_inside(outline: Outline) -> None:
    x, y = outline.point
    assert outline.mask[int(y), int(x)]
    assert min(distance(outline.point, polygon) for polygon in outline.polygons) >= 5


def test_the_mask_is_neither_shifted_nor_turned() -> None:
    rectangle = np.array([[2.0, 1.0], [5.0, 1.0], [5.0, 3.0], [2.0, 3.0]])
    drawn = Outline("a", "b", 7, 4, "", (3.0, 2.0), (rectangle,), "")
    expected = np.zeros((4, 7), dtype=bool)
    expected[1:3, 2:5] = True
    np.testing.assert_array_equal(drawn.mask, expected)


def test_spoon_and_cup_hardly_share_a_pixel() -> None:
    spoon, cup = DRAWN[0].mask, DRAWN[1].mask
    assert (spoon & cup).sum() <= 0.01 * spoon.sum()
