"""Retrieval for localising: best patches, positions, back-projection, votes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gvr_core.books import DepthBook, PatchBook, SemanticVectorBook
from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.localize import (
    best_patches,
    localize,
    relevancy,
    retrieve,
    vote,
)
from gvr_core.models.base import Mask
from gvr_core.run_lengths import patch_positions
from gvr_core.scene import View

WIDTH, HEIGHT = 40, 30


def square(x0: int, y0: int, side: int = 5) -> Mask:
    pixels = np.zeros((HEIGHT, WIDTH), np.bool_)
    pixels[y0 : y0 + side, x0 : x0 + side] = True
    return Mask(pixels)


def views_around(n: int) -> list[View]:
    K = intrinsics(60, WIDTH, HEIGHT)
    eyes = [(5 * np.cos(a), 5 * np.sin(a), 2.0) for a in 2 * np.pi * np.arange(n) / n]
    return [
        View(f"v{i}", Camera(K, look_at(eye, (0, 0, 0), (0, 0, 1)), WIDTH, HEIGHT))
        for i, eye in enumerate(eyes)
    ]


def book_of(masks: list[list[Mask]], features: np.ndarray) -> SemanticVectorBook:
    patches = PatchBook.of_masks(masks, [(HEIGHT, WIDTH)] * len(masks))
    return SemanticVectorBook(features.astype(np.float32), patches)


def depth_of(value: np.ndarray) -> DepthBook:
    n = len(value)
    flat = np.repeat(value.astype(np.float32), WIDTH * HEIGHT)
    return DepthBook(flat, flat, np.array([[HEIGHT, WIDTH]] * n, np.int32))


def test_relevancy_is_the_cosine() -> None:
    features = np.array([[1, 0], [0, 1], [np.sqrt(0.5)] * 2], np.float32)
    np.testing.assert_allclose(
        relevancy(features, np.float32([[1, 0]])), [[1, 0, np.sqrt(0.5)]], rtol=1e-6
    )


def test_best_patch_of_each_view_first_of_equals_and_views_without_patches() -> None:
    scores = np.array([0.1, 0.9, 0.9, 0.2, 0.7], np.float32)
    views, best = best_patches(scores, np.array([0, 3, 3, 5]))
    assert views.tolist() == [0, 2]
    assert best.tolist() == [1, 4]


def position(pixels: np.ndarray) -> tuple[float, float]:
    patches = PatchBook.of_masks([[Mask(pixels)]], [pixels.shape])
    x, y = patch_positions(patches, np.array([0]))[0]
    return float(x), float(y)


def test_position_of_a_convex_patch_is_its_centre() -> None:
    assert position(square(10, 4).pixels) == (12.5, 6.5)


def test_position_of_a_ring_lies_on_the_ring() -> None:
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    ring = np.abs(np.hypot(rows - 15, columns - 20) - 8) < 1
    x, y = position(ring)
    assert ring[int(y), int(x)]


def asked(book, depths, views, text, **settings):
    scores = relevancy(book.features, np.float32([text]))[0]
    return retrieve(scores, book.patches, depths, views, **settings)


def test_retrieval_back_projects_each_views_best_patch() -> None:
    views = views_around(3)
    masks = [[square(2, 2), square(18, 13)], [square(18, 13)], [square(30, 20), square(18, 13)]]
    features = np.array([[0, 1], [1, 0], [1, 0], [0.6, 0.8], [0.8, 0.6]])
    depth = np.array([4.0, 5.0, 6.0])
    found = asked(book_of(masks, features), depth_of(depth), views, [1, 0])
    assert found.patches.tolist() == [1, 2, 4]
    np.testing.assert_allclose(found.relevancies, [1, 1, 0.8], rtol=1e-6)
    for i in range(3):
        pixel, z = views[i].camera.project(found.points[i])
        np.testing.assert_allclose(pixel, (20.5, 15.5), atol=1e-9)
        assert z == pytest.approx(depth[i])


def test_views_without_depth_abstain() -> None:
    views = views_around(2)
    book = book_of([[square(18, 13)], [square(18, 13)]], np.eye(2))
    found = asked(book, depth_of(np.array([0.0, 3.0])), views, [1, 0])
    assert found.views.tolist() == [1]


def test_top_k_keeps_the_most_similar_views() -> None:
    views = views_around(4)
    features = np.array([[0.2, 0], [0.9, 0], [0.5, 0], [0.7, 0]])
    book = book_of([[square(18, 13)]] * 4, features)
    found = asked(book, depth_of(np.full(4, 5.0)), views, [1, 0], top_k=2)
    assert found.views.tolist() == [1, 3]


def test_nothing_to_vote_on_gives_no_location() -> None:
    book = book_of([[], []], np.empty((0, 2)))
    nothing = np.empty(0, np.float32)
    assert localize(nothing, book.patches, depth_of(np.ones(2)), views_around(2)) is None


def test_location_is_the_mean_of_the_agreeing_views() -> None:
    views = views_around(6)
    target = np.array([0.3, -0.2, 0.4])
    masks, depths = [], []
    for i, view in enumerate(views):
        (x, y), z = view.camera.project(target)
        # The last view retrieves something else, in a corner.
        masks.append([square(int(x) - 2, int(y) - 2)] if i < 5 else [square(0, 0)])
        depths.append(float(z))
    book = book_of(masks, np.ones((6, 1)))
    scores = relevancy(book.features, np.float32([[1]]))[0]
    found = localize(scores, book.patches, depth_of(np.array(depths)), views)
    assert found is not None
    assert found.supporters.tolist() == [True] * 5 + [False]
    # Pixel centres are up to half a pixel off the projected point: about 0.1 units at depth 5.
    assert np.linalg.norm(found.location - target) < 0.15


def test_vote_prefers_the_larger_then_the_tighter_group() -> None:
    loose = np.array([[0, 0, 0], [0.9, 0, 0], [0, 0.9, 0]], float)
    tight = loose * 0.1 + 10
    assert vote(np.concatenate([loose, tight]), 1.0).tolist() == [False] * 3 + [True] * 3
    assert vote(np.concatenate([loose, tight[:2]]), 1.0)[:3].all()


def brute_force_votes(points: np.ndarray, radius: float) -> list[int]:
    return [sum(float(np.sqrt(((p - q) ** 2).sum())) <= radius for q in points) for p in points]


@given(
    arrays(np.float64, st.tuples(st.integers(1, 12), st.just(3)), elements=st.floats(-5, 5)),
    st.floats(0.01, 5),
)
def test_the_winner_has_the_most_votes(points: np.ndarray, radius: float) -> None:
    supporters = vote(points, radius)
    assert supporters.sum() == max(brute_force_votes(points, radius))
