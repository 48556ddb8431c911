"""The books: what goes in comes out, also through named arrays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gvr_core.books import DepthBook, PatchBook, SemanticVectorBook, ViewBook
from gvr_core.errors import StoreError
from gvr_core.models.base import Mask


@given(st.integers(0, 2**32 - 1))
def test_patches_come_back_as_they_were(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = [tuple(int(s) for s in rng.integers(1, 20, 2)) for _ in range(4)]
    masks = [
        [
            Mask(rng.random(size) > rng.random(), float(rng.random()), int(rng.integers(3)))
            for _ in range(rng.integers(0, 4))
        ]
        for size in sizes
    ]
    book = PatchBook.from_arrays(PatchBook.of_masks(masks, sizes).to_arrays())
    assert book.n_views == 4
    for i, view in enumerate(masks):
        kept = [mask for mask in view if mask.area]
        back = book.masks_of(i)
        assert len(back) == len(kept)
        for was, now in zip(kept, back, strict=True):
            np.testing.assert_array_equal(was.pixels, now.pixels)
            assert now.level == was.level
            assert now.score == pytest.approx(was.score)
    for j in range(len(book)):
        assert book.areas[j] == book.pixels(j).sum()
        assert Mask(book.pixels(j)).box == tuple(book.boxes[j])


def test_views_of_different_sizes() -> None:
    rng = np.random.default_rng(0)
    sizes = np.array([[2, 3], [4, 5], [1, 7]], np.int32)
    total = int((sizes[:, 0] * sizes[:, 1]).sum())
    colours = rng.integers(0, 255, (total, 3), dtype=np.uint8)
    book = ViewBook(colours, colours[:, 0], sizes)
    np.testing.assert_array_equal(book.rgb(1), colours[6:26].reshape(4, 5, 3))
    np.testing.assert_array_equal(book.alpha(2), colours[26:, 0].reshape(1, 7))
    depth = rng.random(total).astype(np.float32)
    depths = DepthBook(depth, -depth, sizes)
    np.testing.assert_array_equal(depths.depth(0), depth[:6].reshape(2, 3))
    np.testing.assert_array_equal(depths.depth(0, "median"), -depth[:6].reshape(2, 3))


def test_a_book_that_lacks_an_array_is_refused() -> None:
    arrays = PatchBook.of_masks([[]], [(2, 2)]).to_arrays()
    del arrays["rle"]
    with pytest.raises(StoreError, match="rle"):
        PatchBook.from_arrays(arrays)


def test_features_must_match_the_patches() -> None:
    patches = PatchBook.of_masks([[Mask(np.ones((2, 2), np.bool_))]], [(2, 2)])
    with pytest.raises(StoreError, match="1 patches"):
        SemanticVectorBook(np.ones((2, 4), np.float32), patches)
