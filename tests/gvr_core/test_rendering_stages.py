"""The stages of the CPU renderer one by one: sorting, projection, binning, sums, threads."""

from __future__ import annotations

import itertools
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from render_scenes import camera, cloud

from gvr_core.rendering.binning import bin_piece, cursors
from gvr_core.rendering.compiled import run_pieces
from gvr_core.rendering.layout import DEPTH, MEAN_X, MEAN_Y, T0, T_MIN, TILE, A, B, C
from gvr_core.rendering.numba_renderer import NumbaRenderer
from gvr_core.rendering.sorting import radix_argsort
from gvr_core.rendering.weights import sum_pairs

depths = st.lists(st.floats(2**-7, 2**20, width=32), max_size=200)


@settings(max_examples=60, deadline=None)
@given(depths)
def test_depths_are_sorted_stably(values: list[float]) -> None:
    keys = np.array(values, np.float32)
    numbers = np.arange(keys.size, dtype=np.int32)
    order = radix_argsort(keys.view(np.uint32).copy(), numbers.copy())
    np.testing.assert_array_equal(order, np.argsort(keys, kind="stable"))


def test_many_equal_depths_keep_their_order() -> None:
    keys = np.random.default_rng(0).integers(0, 7, 50_000).astype(np.float32)
    order = radix_argsort(keys.view(np.uint32).copy(), np.arange(50_000, dtype=np.int32))
    np.testing.assert_array_equal(order, np.argsort(keys, kind="stable"))


@pytest.mark.parametrize("size", [0.1, 1.0, 10.0])
def test_binning_finds_the_tiles_with_a_covered_pixel_centre_and_hardly_any_other(
    size: float,
) -> None:
    view = camera(150, 101)
    rows, seen = NumbaRenderer()._project(cloud(3, 2500, 0, size), view)
    rows = rows[seen]
    tiles_x, tiles_y = 10, 7
    window = (0, tiles_x, 0, tiles_y)
    counts = np.zeros((1, tiles_x * tiles_y), np.int64)
    first_pair = np.empty(tiles_x * tiles_y + 1, np.int64)
    nothing = np.empty(0, np.int32)
    bin_piece(0, len(rows), rows, tiles_x, *window, counts[0], nothing, False)
    cursors(counts, first_pair)
    pairs = np.empty(first_pair[-1], np.int32)
    bin_piece(0, len(rows), rows, tiles_x, *window, counts[0], pairs, True)
    found = np.zeros((tiles_x * tiles_y, len(rows)), bool)
    for tile, (begin, end) in enumerate(itertools.pairwise(first_pair)):
        assert (np.diff(pairs[begin:end]) > 0).all()  # front to back, none twice
        found[tile, pairs[begin:end]] = True

    x = np.arange(tiles_x * TILE) + 0.5
    y = (np.arange(tiles_y * TILE) + 0.5)[:, None]
    expected = np.zeros_like(found)
    roomy = np.zeros_like(found)
    for n, row in enumerate(rows.astype(np.float64)):
        dx, dy = x - row[MEAN_X], y - row[MEAN_Y]
        exponent = (row[A] * dx - row[B] * dy) ** 2 + (row[C] * dy) ** 2
        for wide, table in ((1.0, expected), (1.01, roomy)):
            covered = (exponent <= (row[T0] - T_MIN) * wide).reshape(tiles_y, TILE, tiles_x, TILE)
            table[:, n] = covered.any(axis=(1, 3)).ravel()
    assert expected.sum() > 500
    assert not (expected & ~found).any()
    # What is found in excess meets the band of a tile's pixel centres between two of them.
    assert (found & ~roomy).sum() <= 0.05 * expected.sum()


def test_means_and_depths_are_those_of_the_camera() -> None:
    view = camera(150, 101, offset=(5.0, -3.0), aspect=1.2)
    gaussians = cloud(4, 2000)
    rows, seen = NumbaRenderer()._project(gaussians, view)
    pixels, z = view.project(gaussians.means[seen])
    np.testing.assert_allclose(rows[seen][:, [MEAN_X, MEAN_Y]], pixels, rtol=2e-7, atol=1e-6)
    np.testing.assert_allclose(rows[seen, DEPTH], z, rtol=1e-7)
    unseen = np.setdiff1d(np.arange(2000), seen)
    assert unseen.size > 100


def test_sums_of_pairs_do_not_lose_small_parts() -> None:
    pairs = np.repeat(np.int32([1, 0, 1]), [1, 3, 100_000])
    values = np.ones(pairs.size, np.float32)
    values[0] = 2.0**24  # float32 ends to count in ones here
    np.testing.assert_array_equal(sum_pairs(3, pairs, values), np.float32([3, 2**24 + 1e5, 0]))


@pytest.mark.parametrize(("pieces", "threads"), [(0, 2), (1, 4), (7, 1), (50, 3), (5, 64)])
def test_each_piece_is_done_once(pieces: int, threads: int) -> None:
    done: list[int] = []
    run_pieces(done.append, pieces, threads)
    assert sorted(done) == list(range(pieces))


def test_pieces_run_at_the_same_time_and_errors_come_out() -> None:
    together = threading.Barrier(2, timeout=20)

    def meet(piece: int) -> None:
        together.wait()

    run_pieces(meet, 2, 2)

    def fail(piece: int) -> None:
        if piece == 3:
            raise ValueError("piece 3")

    for threads in (1, 2):
        with pytest.raises(ValueError, match="piece 3"):
            run_pieces(fail, 20, threads)
