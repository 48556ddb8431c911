"""Polygons that draw a mask exactly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from datasets.outline_polygons import outline_polygons, polygon_area
from datasets.polygons import PolygonMask

MASKS = arrays.arrays(bool, arrays.array_shapes(min_dims=2, max_dims=2, max_side=16))


def drawn(mask: np.ndarray) -> np.ndarray:
    polygons = outline_polygons(mask)
    assert all(polygon.ndim == 2 and polygon.shape[0] >= 3 for polygon in polygons)
    assert all((polygon >= 0).all() and polygon_area(polygon) > 0 for polygon in polygons)
    return PolygonMask(polygons, (mask.shape[1], mask.shape[0])).pixels()


@settings(max_examples=300, deadline=None)
@given(MASKS)
def test_random_masks_come_back(mask: np.ndarray) -> None:
    assert np.array_equal(drawn(mask), mask)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.97), st.integers(1, 70), st.integers(1, 70))
def test_random_masks_of_any_density_come_back(
    seed: int, density: float, width: int, height: int
) -> None:
    mask = np.random.default_rng(seed).random((height, width)) < density
    assert np.array_equal(drawn(mask), mask)


@pytest.mark.parametrize("height, width", [(1, 1), (1, 7), (7, 1), (2, 2), (731, 988)])
def test_full_and_empty_masks(height: int, width: int) -> None:
    assert outline_polygons(np.zeros((height, width), bool)) == ()
    full = np.ones((height, width), bool)
    assert len(outline_polygons(full)) == 1 and np.array_equal(drawn(full), full)


def test_a_part_without_holes_is_one_polygon_and_a_ring_two() -> None:
    mask = np.zeros((20, 20), bool)
    mask[2:9, 2:9] = True
    mask[12:18, 3:5] = True
    assert len(outline_polygons(mask)) == 2
    mask[5, 5] = False
    assert len(outline_polygons(mask)) == 3 and np.array_equal(drawn(mask), mask)


@pytest.mark.parametrize("step", [(0, 0), (1, 0), (0, 1), (1, 1), (-1, 1)])
def test_runs_of_one_and_two_pixels_have_three_corners(step: tuple[int, int]) -> None:
    mask = np.zeros((5, 5), bool)
    mask[2, 2] = mask[2 + step[1], 2 + step[0]] = True
    assert np.array_equal(drawn(mask), mask)


def test_polygons_read_from_json_are_the_same() -> None:
    import json

    mask = np.random.default_rng(0).random((30, 40)) < 0.6
    polygons = json.loads(json.dumps([p.tolist() for p in outline_polygons(mask)]))
    read = PolygonMask(tuple(np.array(p, np.float64) for p in polygons), (40, 30))
    assert np.array_equal(read.pixels(), mask)


def test_areas_are_those_of_school() -> None:
    square = np.array([[2.0, 3.0], [5.0, 3.0], [5.0, 7.0], [2.0, 7.0]])
    assert polygon_area(square) == polygon_area(square[::-1]) == 12
    assert polygon_area(square[[0, 1, 0]]) == 0
