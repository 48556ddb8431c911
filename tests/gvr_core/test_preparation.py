"""Preparation: one render a view, views side by side, vectors of half precision."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from itertools import count

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_scene import two_boxes

from gvr_core import preparation
from gvr_core.books import PatchBook, SemanticVectorBook, view_frame
from gvr_core.cameras import Camera
from gvr_core.gaussians import Gaussians
from gvr_core.localize import best_patches, relevancy
from gvr_core.models.base import Frame, Mask, views_at_once
from gvr_core.models.graph_segmenter import GraphSegmenter
from gvr_core.models.random_encoder import RandomEncoder
from gvr_core.ordered import in_order
from gvr_core.rendering.base import Rendering, get_renderer
from gvr_core.scene import Scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return two_boxes(5)[0]


@dataclass
class CountingRenderer:
    """The real renderer, counting; a test double in that alone."""

    name: str = "counting"
    renders: int = 0

    def render(self, gaussians: Gaussians, camera: Camera, background=(0.0, 0.0, 0.0), mask=None):
        self.renders += 1
        return get_renderer("numba").render(gaussians, camera, background, mask)


def as_bytes(values: np.ndarray) -> np.ndarray:
    return np.rint(np.clip(values, 0, 1) * np.float32(255)).astype(np.uint8)


def test_books_hold_what_each_view_s_own_render_shows(scene: Scene) -> None:
    renderer, white = CountingRenderer(), (1.0, 1.0, 1.0)
    views, depths = preparation.render_books(scene.gaussians, scene.views, renderer, white)
    assert renderer.renders == len(scene.views) == len(views) == len(depths)
    for i, view in enumerate(scene.views):
        twin: Rendering = get_renderer("numba").render(scene.gaussians, view.camera, white)
        np.testing.assert_array_equal(views.rgb(i), as_bytes(twin.rgb))
        np.testing.assert_array_equal(views.alpha(i), as_bytes(twin.alpha))
        # the depths do not depend on the background, which the depth stage has none of
        dark = get_renderer("numba").render(scene.gaussians, view.camera)
        np.testing.assert_array_equal(depths.depth(i), dark.expected_depth)
        np.testing.assert_array_equal(depths.depth(i, "median"), dark.median_depth)


@dataclass
class SideBySide:
    """A model and how many frames it takes at once; remembers how many it has had."""

    model: GraphSegmenter | RandomEncoder
    views_at_once: int
    most: int = 0
    dim: int = 16
    _now: int = 0
    _changed: threading.Condition = field(default_factory=threading.Condition)

    def _looking(self, look):
        with self._changed:
            self._now += 1
            self.most = max(self.most, self._now)
            self._changed.notify_all()
            if self.views_at_once > 1:  # the first waits for the second, which should come
                self._changed.wait_for(lambda: self.most > 1, timeout=30)
        try:
            return look()
        finally:
            with self._changed:
                self._now -= 1

    def automatic(self, frame: Frame) -> list[Mask]:
        return self._looking(lambda: self.model.automatic(frame))

    def encode_patches(self, frame: Frame, masks: list[Mask]) -> np.ndarray:
        return self._looking(lambda: self.model.encode_patches(frame, masks))


def test_any_number_of_views_at_once_gives_the_same_books(scene: Scene) -> None:
    views, depths = preparation.render_books(scene.gaussians, scene.views, CountingRenderer())
    found = []
    for threads in (1, 2, 4):
        segmenter = SideBySide(GraphSegmenter(), threads)
        encoder = SideBySide(RandomEncoder(0, 16), threads)
        patches = preparation.segment_views(views, depths, scene.views, segmenter)
        book = preparation.encode_patches(views, depths, scene.views, patches, encoder)
        assert max(segmenter.most, encoder.most) <= threads
        assert (segmenter.most > 1) == (threads > 1)
        found.append(patches.to_arrays() | {"features": book.features})
    plain = PatchBook.of_masks(
        [
            GraphSegmenter().automatic(view_frame(views, depths, i, view))
            for i, view in enumerate(scene.views)
        ],
        [(view.camera.height, view.camera.width) for view in scene.views],
    )
    assert len(plain) > len(scene.views)
    for arrays in found:
        for name, array in plain.to_arrays().items():
            np.testing.assert_array_equal(arrays[name], array)
        np.testing.assert_array_equal(arrays["features"], found[0]["features"])


def test_models_take_one_frame_at_a_time_unless_they_say_so() -> None:
    assert views_at_once(RandomEncoder(0)) == 1
    assert 1 <= views_at_once(GraphSegmenter()) <= 4


@pytest.mark.parametrize("threads", [1, 3])
def test_results_come_in_order_and_items_are_taken_as_there_is_room(threads: int) -> None:
    taken = count()
    items = (next(taken) for _ in range(20))

    def work(item: int) -> int:
        time.sleep(0.002 * (item % 3))
        return item * item

    results = in_order(work, items, threads)
    assert next(results) == 0
    assert next(taken) <= threads + 2  # the first, as many as are worked on, one that waits
    assert list(results)[-1] == 20 * 20


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_comes_at_its_place_and_ends_the_rest(threads: int) -> None:
    begun = []

    def work(item: int) -> int:
        begun.append(item)
        if item == 2:
            raise ArithmeticError("no good")
        return item

    results = in_order(work, range(50), threads)
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(ArithmeticError, match="no good"):
        next(results)
    assert len(begun) <= 2 + threads + 2


def unit_vectors(rng: np.random.Generator, n: int, c: int) -> np.ndarray:
    vectors = rng.standard_normal((n, c)).astype(np.float32)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_half_precision_changes_relevancy_by_rounding_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vectors, text = unit_vectors(rng, 2000, 512), unit_vectors(rng, 1, 512)
    one = Mask(np.ones((2, 2), np.bool_))
    patches = PatchBook.of_masks([[one] * 100] * 20, [(2, 2)] * 20)
    book = SemanticVectorBook(vectors.astype(np.float16), patches)
    assert book.vectors.dtype == np.float32
    full, half = relevancy(vectors, text)[0], relevancy(book.vectors, text)[0]
    error = float(np.abs(full - half).max())
    assert error < 1e-4  # of cosines that spread by 0.04
    # whatever is ranked otherwise was as good as equal before
    order = np.argsort(-half)
    assert (np.diff(full[order]) < 2 * error + 1e-7).all()
    for best, twin in zip(
        best_patches(half, patches.view_ptr)[1],
        best_patches(full, patches.view_ptr)[1],
        strict=True,
    ):
        assert best == twin or full[twin] - full[best] <= 2 * error
