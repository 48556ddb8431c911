"""(B) of the robust method, part by part: relevancy, candidates, clusters, places."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gvr_core.books import Books, DepthBook, PatchBook, SemanticVectorBook, ViewBook
from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.models.base import Mask
from gvr_core.robust.candidates import (
    Candidate,
    best_of_each_view,
    eroded,
    gated_patches,
    place_candidate,
)
from gvr_core.robust.clusters import cluster_candidates, geometric_median, places_of
from gvr_core.robust.config import RobustLocate
from gvr_core.robust.locating import find_places
from gvr_core.robust.relevancy import contrast, relevancy
from gvr_core.scene import View

SIZE = (60, 80)


def rectangle(x0: int, y0: int, x1: int, y1: int) -> np.ndarray:
    pixels = np.zeros(SIZE, np.bool_)
    pixels[y0:y1, x0:x1] = True
    return pixels


def camera(x: float = 0.0) -> Camera:
    """Looks along +y, z up."""
    K = intrinsics(60, SIZE[1], SIZE[0])
    return Camera(K, look_at((x, 0, 0), (x, 1, 0), (0, 0, 1)), SIZE[1], SIZE[0])


def books_of(masks: list[list[Mask]], depth: np.ndarray | float = 4.0) -> Books:
    n, pixels = len(masks), SIZE[0] * SIZE[1]
    sizes = np.array([SIZE] * n, np.int32)
    values = np.broadcast_to(np.asarray(depth, np.float32), SIZE).ravel()
    flat = np.tile(values, n).astype(np.float32)
    patches = PatchBook.of_masks(masks, [SIZE] * n)
    features = np.zeros((len(patches), 4), np.float32)
    views = ViewBook(np.zeros((n * pixels, 3), np.uint8), np.zeros(n * pixels, np.uint8), sizes)
    return Books(views, DepthBook(flat, flat, sizes), SemanticVectorBook(features, patches))


def candidate(point, view: int = 0, radius: float = 0.2, relevancy: float = 0.8) -> Candidate:
    where = np.asarray(point, np.float64)
    return Candidate(view, 0, relevancy, (0.0, 0.0), where[None], where, radius)


def test_relevancy_is_the_worst_pairwise_softmax() -> None:
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(9, 5)).astype(np.float32)
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    features, text, negatives = vectors[:5], vectors[5], vectors[6:]
    expected = [
        min(
            np.exp(10 * f @ text) / (np.exp(10 * f @ text) + np.exp(10 * f @ negative))
            for negative in negatives
        )
        for f in features
    ]
    np.testing.assert_allclose(
        relevancy(features @ text, negatives @ features.T, 10.0), expected, rtol=1e-5
    )


def test_contrast_is_the_softmax_against_the_scenes_typical_patch() -> None:
    rng = np.random.default_rng(3)
    vectors = rng.normal(size=(8, 5)).astype(np.float32)
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    features, text = vectors[:7], vectors[7]
    cosines = sorted(float(f @ text) for f in features)
    typical = np.exp(10 * cosines[3])
    expected = [np.exp(10 * (f @ text)) / (np.exp(10 * (f @ text)) + typical) for f in features]
    found = contrast(features @ text, 10.0)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    # the typical patch itself is neither; and what is a little like everything is like nothing
    assert np.sort(found)[3] == pytest.approx(0.5)
    np.testing.assert_allclose(contrast(np.tile(text @ text, 4), 10.0), 0.5)
    assert (contrast(features @ text, 20.0) > 0.5).sum() == 3
    assert contrast(features[:0] @ text, 10.0).shape == (0,)


def test_of_a_whole_and_its_part_the_whole_is_taken_once() -> None:
    masks = [
        [Mask(rectangle(10, 10, 15, 15)), Mask(rectangle(5, 5, 30, 30), level=1)],
        [Mask(rectangle(5, 5, 20, 20)), Mask(rectangle(40, 5, 60, 20))],
    ]
    patches = books_of(masks).semantics.patches
    # equally relevant but for less than a step: the whole; then two apart; then none
    assert gated_patches(np.float32([0.705, 0.701, 0.9, 0.8]), patches, 0.5) == [1, 2, 3]
    assert gated_patches(np.float32([0.9, 0.7, 0.4, 0.8]), patches, 0.5) == [0, 3]
    assert gated_patches(np.float32([0.5, 0.5, 0.5, 0.5]), patches, 0.5) == []
    assert gated_patches(np.float32([0.9, 0.7, 0.4, 0.8]), patches, 0.5, True) == [1, 3]
    assert best_of_each_view(np.float32([0.1, 0.0, 0.4, 0.3]), patches) == [0, 2]


def test_erosion_follows_the_size() -> None:
    assert eroded(rectangle(0, 0, 40, 40)).sum() == 30 * 30
    assert eroded(rectangle(10, 10, 12, 12)).sum() == 0


def test_a_background_at_the_outline_does_not_pull_a_candidate_back() -> None:
    depth = np.full(SIZE, 4.0)
    depth[:, 36:] = 9.0  # the mask's right rim shows the wall
    books = books_of([[Mask(rectangle(20, 20, 40, 40))]], depth)
    views = [View("v", camera())]
    patches = books.semantics.patches
    found = place_candidate(0, 0.9, patches, books.depths, views)
    assert found is not None
    assert found.point[1] == pytest.approx(4.0, abs=1e-5)
    assert (np.abs(found.surface[:, 1] - 4.0) < 1e-4).all()
    half_diagonal = 4.0 * np.hypot(8, 10) / books_camera_focal()
    assert 0.5 * half_diagonal < found.radius <= half_diagonal * 1.1


def books_camera_focal() -> float:
    return float(camera().K[0, 0])


def test_a_patch_without_depth_is_no_candidate() -> None:
    books = books_of([[Mask(rectangle(20, 20, 40, 40))]], 0.0)
    views = [View("v", camera())]
    for median in (True, False):
        patches = books.semantics.patches
        assert place_candidate(0, 0.9, patches, books.depths, views, median) is None


def test_two_groups_make_two_places_and_a_stray_makes_none() -> None:
    near = [candidate((0.1 * i, 0, 0), view=i) for i in range(5)]
    far = [candidate((5 + 0.1 * i, 0, 0), view=i) for i in range(4)]
    stray = [candidate((20, 0, 0))]
    labels, reach = cluster_candidates(near + far + stray, 1.0, 0.05)
    assert reach == pytest.approx(0.2)
    named, places = places_of(near + far + stray, labels, 0.5, 8)
    assert named.tolist() == [0] * 5 + [1] * 4 + [-1]
    assert [round(place.location[0], 2) for place in places] == [0.2, 5.15]
    assert places[0].weight > places[1].weight
    _, strongest = places_of(near + far + stray, labels, 0.5, 1)
    assert len(strongest) == 1


def test_a_weak_second_group_is_no_instance() -> None:
    near = [candidate((0.1 * i, 0, 0)) for i in range(9)]
    far = [candidate((5 + 0.1 * i, 0, 0)) for i in range(3)]
    labels, _ = cluster_candidates(near + far, 1.0, 0.05)
    named, places = places_of(near + far, labels, 0.5, 8)
    assert len(places) == 1
    assert named[9:].tolist() == [-1] * 3


@given(
    points=st.lists(st.tuples(*[st.floats(-10, 10, width=32)] * 3), min_size=1, max_size=12).map(
        np.array
    ),
    scale=st.sampled_from([1e-3, 1.0, 1e3]),
)
@settings(max_examples=60, deadline=None)
def test_the_geometric_median_beats_every_point_of_the_set(points, scale) -> None:
    points = points * scale

    def cost(centre: np.ndarray) -> float:
        return float(np.linalg.norm(points - centre, axis=1).sum())

    best = min(cost(point) for point in points)
    assert cost(geometric_median(points)) <= best * 1.01 + 1e-4 * scale


@pytest.mark.parametrize("scale", [0.01, 1.0, 100.0])
def test_clusters_do_not_depend_on_the_unit(scale: float) -> None:
    rng = np.random.default_rng(1)
    points = rng.normal(size=(30, 3)) * 0.3
    plain = [candidate(p, radius=0.2) for p in points]
    scaled = [candidate(scale * p, radius=0.2 * scale) for p in points]
    one, reach = cluster_candidates(plain, 1.0, 0.05)
    other, scaled_reach = cluster_candidates(scaled, 1.0, 0.05)
    np.testing.assert_array_equal(one, other)
    assert scaled_reach == pytest.approx(scale * reach)


def sideways(n: int) -> list[View]:
    return [View(f"v{i}", camera(0.05 * i)) for i in range(n)]


def test_nothing_like_the_query_is_not_here() -> None:
    books = books_of([[Mask(rectangle(20, 20, 40, 40))]] * 4)
    scores = np.full(4, 0.4, np.float32)
    found = find_places(books, sideways(4), scores, RobustLocate(), 0.5)
    assert found.places == ()
    assert found.location is None
    assert found.confidence == pytest.approx(0.4)
    forced = find_places(books, sideways(4), scores, RobustLocate(refusal=False), 0.5)
    assert len(forced.places) == 1


def test_one_view_alone_is_not_enough() -> None:
    masks = [[Mask(rectangle(20, 20, 40, 40))]] + [[]] * 3
    scores = np.full(1, 0.95, np.float32)
    assert not find_places(books_of(masks), sideways(4), scores, RobustLocate(), 0.5).places
    lenient = RobustLocate(min_views=1)
    assert len(find_places(books_of(masks), sideways(4), scores, lenient, 0.4).places) == 1


def test_what_fills_the_views_is_stuff() -> None:
    wide = [[Mask(rectangle(0, 20, 80, 60))]] * 4
    scores = np.full(4, 0.9, np.float32)
    found = find_places(books_of(wide), sideways(4), scores, RobustLocate(), 0.5)
    assert found.is_stuff
    assert (found.labels == 0).all()
    assert not find_places(
        books_of(wide), sideways(4), scores, RobustLocate(stuff=False), 0.5
    ).is_stuff


def test_without_clusters_the_papers_vote_decides() -> None:
    masks = [[Mask(rectangle(20, 20, 40, 40))]] * 4 + [[Mask(rectangle(60, 40, 78, 58))]]
    scores = np.full(5, 0.9, np.float32)
    config = RobustLocate(density_clusters=False, several_patches=False)
    found = find_places(books_of(masks), sideways(5), scores, config, 0.5)
    assert found.labels.tolist() == [0] * 4 + [-1]
    assert len(found.places) == 1
