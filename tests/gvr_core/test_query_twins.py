"""Every fast way of the query path against its slow twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import query_twins as slow
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from render_scenes import camera, cloud
from small_scene import two_boxes

from gvr_core import localize
from gvr_core.books import DepthBook, PatchBook
from gvr_core.cameras import birds_eye_camera, unproject_each
from gvr_core.models.base import Frame, Mask
from gvr_core.preparation import render_depths
from gvr_core.rendering import get_renderer
from gvr_core.robust.candidates import _same_thing, eroded, place_candidate
from gvr_core.robust.clusters import geometric_median
from gvr_core.robust.observation import observed_share
from gvr_core.run_lengths import cropped, patch_positions
from gvr_core.scene import Scene
from gvr_core.segment import frustum_filter

masks_of_any_shape = arrays(
    np.bool_, st.tuples(st.integers(1, 23), st.integers(1, 23)), elements=st.booleans()
).filter(lambda mask: mask.any())


def blobs(rng: np.random.Generator, height: int, width: int, count: int) -> list[Mask]:
    """Rectangles with holes, some at the border, some of one pixel."""
    masks = []
    for _ in range(count):
        x, y = np.sort(rng.integers(0, width, 2)), np.sort(rng.integers(0, height, 2))
        pixels = np.zeros((height, width), np.bool_)
        pixels[y[0] : y[1] + 1, x[0] : x[1] + 1] = True
        pixels &= rng.random((height, width)) < rng.choice([0.2, 0.97, 1.0])
        pixels[y[0], x[0]] = True
        masks.append(Mask(pixels))
    return masks


@settings(max_examples=200, deadline=None)
@given(masks_of_any_shape)
def test_positions_and_crops_read_off_run_lengths(pixels: np.ndarray) -> None:
    patches = PatchBook.of_masks([[Mask(pixels)]], [pixels.shape])
    x, y = patch_positions(patches, np.array([0]))[0]
    assert (x, y) == slow.patch_position(pixels)
    part, (x0, y0) = cropped(patches, 0)
    x0_, y0_, x1, y1 = patches.boxes[0]
    assert (x0, y0) == (x0_, y0_)
    np.testing.assert_array_equal(part, pixels[y0:y1, x0:x1])


def test_positions_of_large_masks_in_views_of_many_sizes() -> None:
    rng = np.random.default_rng(0)
    sizes = [(480, 640), (731, 988), (64, 48), (1, 300), (300, 1)]
    patches = PatchBook.of_masks([blobs(rng, *size, 12) for size in sizes], sizes)
    chosen = rng.permutation(len(patches))
    fast = patch_positions(patches, chosen)
    assert [tuple(row) for row in fast] == [
        slow.patch_position(patches.pixels(int(j))) for j in chosen
    ]


@given(st.lists(st.integers(0, 4), max_size=12), st.integers(0, 2**32 - 1))
def test_best_patches_with_ties_and_empty_views(counts: list[int], seed: int) -> None:
    view_ptr = np.cumsum([0, *counts])
    scores = np.random.default_rng(seed).integers(0, 3, view_ptr[-1]).astype(np.float32)
    fast, plain = localize.best_patches(scores, view_ptr), slow.best_patches(scores, view_ptr)
    np.testing.assert_array_equal(fast[0], plain[0])
    np.testing.assert_array_equal(fast[1], plain[1])


@pytest.mark.parametrize("n", [1, 7, 300])
def test_votes_in_chunks_are_those_of_all_pairs(n: int, monkeypatch) -> None:
    monkeypatch.setattr(localize, "POINTS_A_CHUNK", 64)
    points = np.random.default_rng(n).normal(size=(n, 3))
    for radius in (0.0, 0.3, 1.0, 10.0):
        np.testing.assert_array_equal(localize.vote(points, radius), slow.vote(points, radius))


@pytest.mark.parametrize("seed", range(4))
def test_centres_under_a_mask_in_one_pass(seed: int) -> None:
    rng = np.random.default_rng(seed)
    gaussians = cloud(seed, 70_000)
    view = camera(150, 101, offset=(5.0, -3.0), aspect=1.2)
    mask = rng.random((101, 150)) < 0.5
    expected = slow.frustum_filter(gaussians, view, mask)
    found = frustum_filter(gaussians, view, mask)
    # products are summed in another order: a centre on the edge of a pixel may fall to its side
    assert np.count_nonzero(found != expected) <= 1 and expected.sum() > 1000
    asked = rng.random(70_000) < 0.3
    np.testing.assert_array_equal(frustum_filter(gaussians, view, mask, asked), found & asked)


def test_points_of_many_cameras_at_once() -> None:
    rng = np.random.default_rng(0)
    cameras = [camera(150, 101, rng.normal(size=3) + 2, offset=(3, 1)) for _ in range(20)]
    pixels, depths = rng.uniform(0, 100, (20, 2)), rng.uniform(0.5, 9, 20)
    plain = [c.unproject(p, z) for c, p, z in zip(cameras, pixels, depths, strict=True)]
    np.testing.assert_allclose(unproject_each(cameras, pixels, depths), plain, rtol=1e-12)
    assert unproject_each([], np.empty((0, 2)), np.empty(0)).shape == (0, 3)


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
def test_relevancy_in_chunks_of_one_shape(dtype, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(localize, "PATCHES_A_CHUNK", 100)
    rng = np.random.default_rng(0)
    stored = np.lib.format.open_memmap(tmp_path / "f.npy", "w+", dtype, (1234, 64))
    stored[:] = rng.normal(size=(1234, 64)) / 8
    texts = rng.normal(size=(37, 64)).astype(np.float32)
    together = localize.relevancy(stored, texts)
    assert together.dtype == np.float32 and together.shape == (37, 1234)
    exact = texts.astype(np.float64) @ stored.astype(np.float64).T
    np.testing.assert_allclose(together, exact, atol=2e-5)
    for first, last in ((0, 1), (36, 37), (3, 20), (15, 17)):
        alone = localize.relevancy(stored, texts[first:last])
        np.testing.assert_array_equal(alone, together[first:last])


@pytest.fixture(scope="module")
def looked_at() -> tuple[Scene, DepthBook, PatchBook]:
    """Two boxes in eight views with their depths, and patches anywhere."""
    scene, _ = two_boxes()
    depths = render_depths(scene.gaussians, scene.views, get_renderer("numba"))
    rng = np.random.default_rng(0)
    masks = [blobs(rng, 72, 96, 14) for _ in scene.views]
    return scene, depths, PatchBook.of_masks(masks, [(72, 96)] * len(scene.views))


@pytest.mark.parametrize("median", [True, False])
def test_candidates_are_those_of_whole_pictures(looked_at, median) -> None:
    scene, depths, patches = looked_at
    found = 0
    for j in range(len(patches)):
        fast = place_candidate(j, 0.5, patches, depths, scene.views, median)
        plain = slow.place_candidate(j, 0.5, patches, depths, scene.views, median)
        assert (fast is None) == (plain is None)
        if fast is None or plain is None:
            continue
        found += 1
        assert (fast.view, fast.patch, fast.pixel) == (plain.view, plain.patch, plain.pixel)
        np.testing.assert_allclose(fast.surface, plain.surface, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(fast.point, plain.point, rtol=1e-9, atol=1e-12)
        assert fast.radius == pytest.approx(plain.radius, rel=1e-9)
    assert found > len(patches) // 2


def test_erosion_and_overlap_are_those_of_whole_pictures(looked_at) -> None:
    patches = looked_at[2]
    same = 0
    for j in range(len(patches)):
        np.testing.assert_array_equal(eroded(patches.pixels(j)), slow.eroded(patches.pixels(j)))
        for other in range(int(patches.view_ptr[patches.view_of(j)]), j):
            expected = slow.same_thing(patches, j, other)
            assert _same_thing(patches, j, other) == expected
            same += expected
    assert same > 10


def test_what_cameras_have_seen_is_looked_up_in_all_views_at_once(looked_at) -> None:
    scene, depths, _ = looked_at
    above = birds_eye_camera((0.4, 0, 0), (0, 0, 1), 5.0, scene.views[0].camera.K, 96, 72)
    frame = Frame.of_rendering(get_renderer("numba").render(scene.gaussians, above), above)
    rng = np.random.default_rng(0)
    shares = set()
    for degrees in (30.0, 50.0, 65.0, 89.0):
        mask = rng.random((72, 96)) < 0.5
        share = observed_share(scene, depths, frame, mask, degrees)
        assert share == slow.observed_share(scene, depths, frame, mask, degrees)
        shares.add(share)
    assert len(shares) > 1
    nothing = np.zeros((72, 96), np.bool_)
    assert observed_share(replace(scene), depths, frame, nothing, 60.0) == 0.0


def test_the_geometric_median_is_that_of_plain_numpy() -> None:
    rng = np.random.default_rng(0)
    for n in (1, 2, 5, 1000):
        points = rng.normal(size=(n, 3)) * 3 + 100
        np.testing.assert_allclose(
            geometric_median(points), slow.geometric_median(points), rtol=1e-7
        )
