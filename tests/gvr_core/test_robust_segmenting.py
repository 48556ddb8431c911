"""(C) of the robust method, part by part: which views vote, and how much each counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from oracle_boxes import RED, World, boxes

from gvr_core.books import Books
from gvr_core.cameras import Camera, look_at
from gvr_core.localize import Localization
from gvr_core.models.base import Frame, Mask
from gvr_core.models.oracle import OracleSegmenter, oracle_models
from gvr_core.rendering import get_renderer
from gvr_core.robust.config import RobustSegment
from gvr_core.robust.segmenting import segment_area, segment_thing, spread_views
from gvr_core.robust.workplace import Workplace
from gvr_core.toolbox import Toolbox
from gvr_core.workspace import Workspace


@pytest.fixture(scope="module")
def world() -> World:
    return boxes()


@pytest.fixture(scope="module")
def books(world: World) -> Books:
    return world.method().prepare(world.scene)


@pytest.fixture(scope="module")
def place(world: World, books: Books) -> Localization:
    found = world.method().locate(world.scene, books, RED)
    assert found is not None
    return found


def workplace(world: World, books: Books, **changes: object) -> Workplace:
    tools = Toolbox(get_renderer("numba"), oracle_models(world.oracle))
    up = np.array([0.0, 0.0, 1.0])
    return Workplace(
        replace(world.scene, up=up),
        books,
        tools,
        RobustSegment.model_validate(changes),
        books.index["steady"],
        (0.0, 0.0, 0.0),
        Workspace(books.semantics.features, None),
    )


def circle(n: int, radius: float = 3.0) -> np.ndarray:
    yaw = 2 * np.pi * np.arange(n) / n
    return radius * np.stack([np.cos(yaw), np.sin(yaw), np.zeros(n)], axis=1)


def test_few_views_are_all_taken() -> None:
    assert spread_views(circle(4), np.zeros(3), np.ones(4), 4) == [0, 1, 2, 3]
    assert spread_views(circle(4), np.zeros(3), np.ones(4), 9) == [0, 1, 2, 3]


def test_the_most_trusted_view_and_those_furthest_from_it_are_taken() -> None:
    trust = np.ones(16)
    trust[5] = 2.0
    assert spread_views(circle(16), np.zeros(3), trust, 1) == [5]
    assert spread_views(circle(16), np.zeros(3), trust, 2) == [5, 13]
    assert spread_views(circle(16), np.zeros(3), trust, 4) == [1, 5, 9, 13]


def test_directions_count_and_not_distances() -> None:
    """Many far views on one side: the few on the other sides are taken all the same."""
    rng = np.random.default_rng(0)
    crowd = np.array([10.0, 0, 0]) + rng.normal(0, 0.5, (40, 3))
    others = np.array([[-0.5, 0, 0], [0, 0.5, 0], [0, -0.5, 0]])
    eyes = np.concatenate([crowd, others]) + np.array([7, 8, 9])
    chosen = spread_views(eyes, np.array([7.0, 8, 9]), np.ones(43), 4)
    assert chosen[1:] == [40, 41, 42]


@given(
    eyes=arrays(
        np.float64, st.tuples(st.integers(5, 25), st.just(3)), elements=st.floats(-5, 5, width=16)
    ),
    most=st.integers(1, 4),
)
@settings(max_examples=60, deadline=None)
def test_so_many_different_views_are_taken_the_same_ones_each_time(eyes, most) -> None:
    trust = np.linspace(1, 2, len(eyes))
    chosen = spread_views(eyes, np.zeros(3), trust, most)
    assert len(set(chosen)) == most and chosen == sorted(chosen)
    assert len(eyes) - 1 in chosen
    assert spread_views(eyes.copy(), np.zeros(3), trust.copy(), most) == chosen
    # powers of two scale without rounding
    assert spread_views(64 * eyes, np.zeros(3), 8 * trust, most) == chosen


def test_a_chosen_set_is_nearly_as_spread_as_can_be() -> None:
    """Farthest-first is within a factor of two of the best spread (Gonzalez 1985)."""
    rng = np.random.default_rng(4)
    eyes = rng.normal(size=(12, 3))
    unit = eyes / np.linalg.norm(eyes, axis=1, keepdims=True)
    angles = np.arccos(np.clip(unit @ unit.T, -1, 1)) + 9 * np.eye(12)
    chosen = spread_views(eyes, np.zeros(3), np.ones(12), 3)
    every = [
        angles[np.ix_(c, c)].min()
        for c in ([i, j, k] for i in range(12) for j in range(i) for k in range(j))
    ]
    assert angles[np.ix_(chosen, chosen)].min() >= max(every) / 2


def test_a_view_counts_by_the_area_of_its_pixels_and_not_by_their_number(world, books) -> None:
    work, place = workplace(world, books), np.array([0.0, 0.0, 0.3])
    typical = world.scene.views[0].camera  # all stand equally far from there
    assert work.pixel_area(typical, place) == pytest.approx(1.0)
    near = look_at((typical.position + place) / 2, place, (0, 0, 1))
    half = Camera(typical.K, near, typical.width, typical.height)
    assert work.pixel_area(half, place) == pytest.approx(0.25)
    fine = typical.resized(3 * typical.width, 2 * typical.height)
    assert work.pixel_area(fine, place) == pytest.approx(1 / 6)


def test_few_voting_views_give_nearly_the_same_surface(world, books, place) -> None:
    truth = world.truth(RED)
    for most in (3, 16):
        area = segment_area(workplace(world, books, vote_views=most, cleanup=False), place)
        assert truth[area.flags].mean() >= 0.95
    lone = segment_area(workplace(world, books, vote_views=1, cleanup=False), place)
    assert np.count_nonzero(lone.flags) < np.count_nonzero(area.flags)


def test_an_area_has_the_shares_as_scores(world, books, place) -> None:
    area = segment_area(workplace(world, books), place)
    assert area.bev is None and len(area.ring) == 0
    assert area.flags.dtype == np.bool_ and area.scores.dtype == np.float32
    assert ((area.scores >= 0.5) == area.flags).all()
    assert len(np.unique(area.scores)) > 20


def test_an_untrusted_view_from_above_has_no_vote(world, books, place) -> None:
    """The cameras look down by 25 degrees only; where 80 from above is enough, it is trusted."""
    shut = segment_thing(workplace(world, books), place, 0, RED.text)
    assert shut.bev is not None and shut.bev.mask is not None

    beside = np.roll(shut.bev.mask.pixels, 30, axis=1)

    class Misled(OracleSegmenter):
        def at_point(self, frame: Frame, point: tuple[float, float]) -> Mask:
            return Mask(beside)

    def answer(**changes: object) -> np.ndarray:
        work = workplace(world, books, **changes)
        models = replace(work.tools.models, segmenter=Misled(world.oracle))
        misled = replace(work, tools=replace(work.tools, models=models))
        return segment_thing(misled, place, 0, RED.text).scores

    np.testing.assert_array_equal(answer(), shut.scores)
    for changes in ({"bev_gate": False}, {"observed_share": 0.0}):
        assert not np.array_equal(answer(**changes), shut.scores)
    wide = segment_thing(workplace(world, books, observed_degrees=80.0), place, 0, RED.text)
    free = segment_thing(workplace(world, books, bev_gate=False), place, 0, RED.text)
    np.testing.assert_array_equal(wide.scores, free.scores)


def test_what_is_higher_than_the_object_is_not_drawn_from_above(world, books, place) -> None:
    work = workplace(world, books, bev_gate=False)
    found = segment_thing(work, place, 0, RED.text)
    assert found.bev is not None and found.bev.frame.shown is not None
    shown, heights = found.bev.frame.shown, world.scene.gaussians.means[:, 2]
    spot = place.places[0]
    limit = spot.location[2] + 1.5 * spot.radius
    np.testing.assert_array_equal(shown, books.index["steady"] & (heights <= limit + 1e-6))
    low = replace(spot, radius=0.05)
    flat = segment_thing(work, replace(place, places=(low,)), 0, RED.text)
    assert flat.bev is not None and flat.bev.frame.shown is not None
    assert not flat.bev.frame.shown[heights > spot.location[2] + 0.08].any()
    open_above = workplace(world, books, bev_gate=False, bev_clip=False)
    whole = segment_thing(open_above, replace(place, places=(low,)), 0, RED.text)
    assert whole.bev is not None and whole.bev.frame.shown is not None
    np.testing.assert_array_equal(whole.bev.frame.shown, books.index["steady"])


def test_a_fitted_ring_has_every_centre_in_the_picture(world, books, place) -> None:
    """At a short distance the object leaves the picture; fitted, it does not."""
    for fit in (True, False):
        work = workplace(world, books, ring_fit=fit, ring_distance=0.8)
        ring = segment_thing(work, place, 0, RED.text).ring
        shares = []
        for view in ring:
            assert view.frame.shown is not None
            pixels, z = view.frame.camera.project(world.scene.gaussians.means[view.frame.shown])
            assert (z > 0).all()
            shares.append(((pixels >= 0) & (pixels < (96, 72))).all(axis=1).mean())
        assert len(ring) == 4
        assert min(shares) >= 0.99 if fit else max(shares) < 0.9


def test_the_ring_has_as_many_cameras_as_asked_for_at_the_pitch(world, books, place) -> None:
    work = workplace(world, books, ring_views=6, ring_pitch=50.0)
    ring = segment_thing(work, place, 0, RED.text).ring
    assert len(ring) == 6
    for view in ring:
        assert np.degrees(np.arcsin(-view.frame.camera.forward[2])) == pytest.approx(50, abs=1e-6)


def test_an_empty_mask_from_above_is_no_coarse_set(world, books, place) -> None:
    """Then, with the retrieved views silenced, nothing is left, and that is said."""

    class Blank(OracleSegmenter):
        def at_point(self, frame: Frame, point: tuple[float, float]) -> Mask:
            return Mask(np.zeros(frame.depth.shape, np.bool_), 0.0)

    work = workplace(world, books, bev_gate=False, retrieved_views=False)
    models = replace(work.tools.models, segmenter=Blank(world.oracle))
    blank = replace(work, tools=replace(work.tools, models=models))
    found = segment_thing(blank, place, 0, RED.text)
    assert not found.flags.any() and not found.scores.any() and len(found.ring) == 0
    # the retrieved views make up for it
    helped = replace(blank, config=RobustSegment(bev_gate=False))
    flags = segment_thing(helped, place, 0, RED.text).flags
    assert np.count_nonzero(flags & world.truth(RED)) > 0.8 * np.count_nonzero(world.truth(RED))
