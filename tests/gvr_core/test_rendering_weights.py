"""Weights under many masks, parts of a set, several pictures: each against the plain way."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from render_scenes import camera, cloud, one_torch_thread

from gvr_core.errors import InputError
from gvr_core.rendering.base import mask_by_mask, one_by_one
from gvr_core.rendering.numba_renderer import NumbaRenderer
from gvr_core.rendering.torch_reference import TorchReference

RENDERER = NumbaRenderer(2)
VIEW = camera(150, 101)
CAMERAS = [camera(150, 101, (np.cos(a), np.sin(a), 0.4)) for a in np.linspace(0, 5, 7)]


def some_masks(seed: int = 0, count: int = 9) -> np.ndarray:
    """Rectangles that overlap, the whole picture, one pixel, salt and pepper, and nothing."""
    rng = np.random.default_rng(seed)
    masks = np.zeros((count, 101, 150), np.bool_)
    for mask in masks[4:]:
        x, y = np.sort(rng.integers(0, 150, 2)), np.sort(rng.integers(0, 101, 2))
        mask[y[0] : y[1] + 1, x[0] : x[1] + 1] = True
    masks[0], masks[1, 100, 149] = True, True
    masks[2] = rng.random((101, 150)) < 0.3
    return masks


@pytest.mark.parametrize("size", [0.3, 3.0])
def test_many_masks_at_once_give_the_bits_of_one_render_each(size: float) -> None:
    gaussians, masks = cloud(1, 3000, 0, size), some_masks()
    fast, slow = (
        RENDERER.weights(gaussians, VIEW, masks),
        mask_by_mask(RENDERER, gaussians, VIEW, masks),
    )
    np.testing.assert_array_equal(fast.toarray(), slow.toarray())
    assert fast.dtype == np.float32 and fast.nnz > 1000
    assert (fast.data > 0).all() and fast.has_sorted_indices
    assert fast[:, [3]].nnz == 0


def test_weights_are_those_of_the_slow_twin() -> None:
    gaussians, masks = cloud(2, 1500), some_masks(2, 5)
    shown = np.random.default_rng(2).random(1500) < 0.7
    with one_torch_thread():
        slow = TorchReference().weights(gaussians, VIEW, masks, shown).toarray()
    fast = RENDERER.weights(gaussians, VIEW, masks, shown).toarray()
    assert slow[shown].any() and not slow[~shown].any() and not fast[~shown].any()
    # a decision on 1/255 that falls the other way moves a weight by that much in a pixel
    assert np.percentile(np.abs(fast - slow), 99) < 1e-4
    assert np.abs(fast - slow).max() < 5e-2


def test_one_mask_alone_draws_only_its_tiles_and_gives_the_same_bits() -> None:
    gaussians = cloud(3, 4000, 0, 0.5)
    masks = some_masks(3)
    together = RENDERER.weights(gaussians, VIEW, masks).toarray()
    for k in (1, 5, 8):
        alone = RENDERER.weights(gaussians, VIEW, masks[k : k + 1]).toarray()[:, 0]
        np.testing.assert_array_equal(alone, together[:, k])


def test_the_number_of_threads_does_not_change_a_bit_of_the_weights() -> None:
    gaussians, masks = cloud(4, 5000), some_masks(4)
    first = NumbaRenderer(1).weights(gaussians, VIEW, masks)
    for threads in (2, 5):
        other = NumbaRenderer(threads).weights(gaussians, VIEW, masks)
        np.testing.assert_array_equal(first.data, other.data)
        np.testing.assert_array_equal(first.indices, other.indices)


def test_no_masks_and_no_gaussians_in_sight() -> None:
    gaussians = cloud(5, 50)
    assert RENDERER.weights(gaussians, VIEW, np.zeros((0, 101, 150), np.bool_)).shape == (50, 0)
    away = cloud(5, 50, centre=(100, 100, 100))
    assert RENDERER.weights(away, VIEW, some_masks()).nnz == 0
    nobody = np.zeros(50, np.bool_)
    assert RENDERER.weights(gaussians, VIEW, some_masks(), nobody).nnz == 0
    assert not RENDERER.render(gaussians, VIEW, shown=nobody).alpha.any()


@pytest.mark.parametrize("renderer", [RENDERER, TorchReference()], ids=["numba", "torch"])
def test_what_is_shown_is_drawn_as_the_subset_alone(renderer) -> None:
    gaussians, mask = cloud(6, 800, 1), some_masks()[2].astype(np.float32)
    shown = np.arange(800) % 3 > 0
    with one_torch_thread():
        part = renderer.render(gaussians, VIEW, (0.1, 0.2, 0.3), mask, shown)
        alone = renderer.render(gaussians.subset(shown), VIEW, (0.1, 0.2, 0.3), mask)
    for name in ("rgb", "alpha", "expected_depth", "median_depth"):
        np.testing.assert_array_equal(getattr(part, name), getattr(alone, name))
    np.testing.assert_array_equal(part.weight_inside[shown], alone.weight_inside)
    assert not part.weight_inside[~shown].any() and not part.weight_outside[~shown].any()


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_several_pictures_at_a_time_are_those_of_the_plain_loop(threads: int) -> None:
    gaussians, shown = cloud(7, 2000, 3), np.arange(2000) % 5 > 0
    renderer = NumbaRenderer(threads)
    many = list(renderer.render_many(gaussians, CAMERAS, (0.2, 0.4, 0.6), shown))
    plain = list(one_by_one(renderer, gaussians, CAMERAS, (0.2, 0.4, 0.6), shown))
    assert len(many) == len(plain) == len(CAMERAS)
    for one, other in zip(many, plain, strict=True):
        for name in ("rgb", "alpha", "expected_depth", "median_depth"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert list(renderer.render_many(gaussians, [])) == []


def test_pictures_come_one_after_the_other_and_few_are_held(monkeypatch) -> None:
    begun, lock = 0, threading.Lock()
    render = NumbaRenderer.render

    def counted(self, *arguments, **named):
        nonlocal begun
        with lock:
            begun += 1
        return render(self, *arguments, **named)

    monkeypatch.setattr(NumbaRenderer, "render", counted)
    pictures = RENDERER.render_many(cloud(8, 100), CAMERAS)
    assert begun == 0
    for taken in range(1, len(CAMERAS) + 1):
        next(pictures)
        assert taken <= begun <= taken + 2
    pictures.close()


def test_an_error_in_one_of_several_pictures_comes_out() -> None:
    pictures = RENDERER.render_many(cloud(8, 100), CAMERAS, (2.0, 0.0, 0.0))
    with pytest.raises(InputError, match="background"):
        next(pictures)


@pytest.mark.parametrize("renderer", [RENDERER, TorchReference()], ids=["numba", "torch"])
@pytest.mark.parametrize(
    "masks",
    [np.zeros((2, 100, 150), np.bool_), np.zeros((101, 150), np.bool_), np.zeros((2, 101, 150))],
    ids=["size", "one", "dtype"],
)
def test_masks_that_do_not_fit_are_refused(renderer, masks) -> None:
    with pytest.raises(InputError, match="the masks have shape"):
        renderer.weights(cloud(0, 10), VIEW, masks)


@pytest.mark.parametrize("renderer", [RENDERER, TorchReference()], ids=["numba", "torch"])
@pytest.mark.parametrize("shown", [np.ones(9, np.bool_), np.ones(10)], ids=["size", "dtype"])
def test_flags_that_do_not_fit_are_refused(renderer, shown) -> None:
    with pytest.raises(InputError, match="flags of what to draw"):
        renderer.render(cloud(0, 10), VIEW, shown=shown)
