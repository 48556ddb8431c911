"""Answers as stored arrays, and back: nothing is lost, and nothing is rounded."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle_boxes import ABSENT, BLUE, FLOOR, RED, World, boxes, boxes_and_floor, twins

from gvr_core.books import PatchBook
from gvr_core.cameras import Camera
from gvr_core.localize import Localization, Place, Retrieval
from gvr_core.methods import Grounding
from gvr_core.methods.base import nothing_found
from gvr_core.scene import Query
from tasks.groundings import (
    BEV,
    RING,
    pack_groundings,
    pack_localization,
    unpack_answers,
    unpack_localization,
)
from tasks.store import Store

ARRAYS = ("views", "patches", "relevancies", "pixels", "points")


def assert_same(a: Localization | None, b: Localization | None) -> None:
    """Equal to the last bit, types and shapes included."""
    assert a is not None and b is not None
    pairs = [(getattr(a.retrieval, name), getattr(b.retrieval, name)) for name in ARRAYS]
    pairs += [(a.labels, b.labels)]
    pairs += [(p.location, q.location) for p, q in zip(a.places, b.places, strict=True)]
    for one, other in pairs:
        assert one.dtype == other.dtype and one.shape == other.shape
        assert one.tobytes() == other.tobytes()
    for one, other in [(a, b), *zip(a.places, b.places, strict=True)]:
        assert one.radius == other.radius
    assert [p.weight for p in a.places] == [p.weight for p in b.places]
    assert a.confidence == b.confidence
    assert a.is_stuff is b.is_stuff


def through_json(localization: Localization | None) -> Localization | None:
    return unpack_localization(json.loads(json.dumps(pack_localization(localization))))


def made(n: int, n_places: int, seed: int, is_stuff: bool = False) -> Localization:
    """A localisation of n patches, its numbers with all their digits."""
    rng = np.random.default_rng(seed)
    retrieval = Retrieval(
        rng.integers(0, 99, n),
        rng.integers(0, 2**40, n),
        rng.random(n, np.float32),
        rng.normal(size=(n, 2)) * 1e3,
        rng.normal(size=(n, 3)) * 10.0 ** rng.integers(-9, 9, (n, 1)),
    )
    places = tuple(
        Place(rng.normal(size=3), float(rng.random()), float(rng.random())) for _ in range(n_places)
    )
    labels = rng.integers(-1, max(1, n_places), n)
    numbers = float(rng.random()), float(rng.random())
    return Localization(retrieval, labels, places, *numbers, is_stuff)


@given(
    n=st.integers(0, 9),
    n_places=st.integers(0, 4),
    seed=st.integers(0, 2**32 - 1),
    is_stuff=st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_a_localisation_comes_back_to_the_last_bit(n, n_places, seed, is_stuff) -> None:
    given_one = made(n, n_places, seed, is_stuff)
    assert_same(given_one, through_json(given_one))


def test_what_was_never_asked_comes_back_as_that() -> None:
    assert pack_localization(None) is None
    assert unpack_localization(None) is None


def find(world: World, query: Query, name: str = "gvr-robust") -> Localization | None:
    method = world.method(name)
    return method.locate(world.scene, method.prepare(world.scene), query)


@pytest.mark.parametrize(
    ("world", "query", "n_places", "is_stuff"),
    [
        (twins, RED, 2, False),
        (boxes, RED, 1, False),
        (boxes, ABSENT, 0, False),
        (boxes_and_floor, FLOOR, 1, True),
    ],
)
def test_what_the_robust_method_finds_goes_through_the_store(
    world, query, n_places, is_stuff, tmp_path: Path
) -> None:
    found = find(world(), query)
    assert found is not None
    assert len(found.places) == n_places and found.is_stuff is is_stuff
    store = Store(tmp_path / "store")
    kept = store.put_json("localizations", {query.id: pack_localization(found)})
    again = unpack_localization(store.load_json(kept)[query.id])
    assert_same(found, again)
    assert again is not None
    np.testing.assert_array_equal(again.supporters, found.supporters)
    assert (again.location is None) == (n_places == 0)


def test_what_the_papers_method_finds_goes_through_json() -> None:
    found = find(boxes(), RED, "gvr-paper")
    assert found is not None and len(found.places) == 1
    assert_same(found, through_json(found))


@pytest.fixture(scope="module")
def answered() -> tuple[World, list[Grounding]]:
    """Two boxes, and between them something that is not there."""
    world = boxes()
    method = world.method(robust={"bev_gate": False})
    books = method.prepare(world.scene)
    return world, [method.ground(world.scene, books, query) for query in (RED, ABSENT, BLUE)]


def test_answers_come_back_as_they_were(answered) -> None:
    world, groundings = answered
    n = len(world.scene.gaussians)
    assert n % 8 == 0 and [g.found for g in groundings] == [True, False, True]
    answers = unpack_answers(pack_groundings(groundings, n))
    assert len(answers) == 3
    for answer, grounding in zip(answers, groundings, strict=True):
        np.testing.assert_array_equal(answer.flags, grounding.flags)
        assert answer.flags.dtype == np.bool_
        assert answer.scores.tobytes() == grounding.scores.tobytes()
        assert (answer.found, answer.confidence) == (grounding.found, grounding.confidence)
        if grounding.location is None:
            assert answer.location is None
        else:
            np.testing.assert_array_equal(answer.location, grounding.location)


@pytest.mark.parametrize("n", [1, 7, 8, 9, 1001])
def test_flags_of_any_number_are_packed_eight_to_a_byte(n: int) -> None:
    rng = np.random.default_rng(n)
    some = [rng.random(n) < 0.5 for _ in range(3)]
    groundings = [
        Grounding(flags, flags.astype(np.float32), np.arange(3.0), bool(flags.any()), 0.25)
        for flags in some
    ]
    arrays = pack_groundings(groundings, n)
    assert arrays["flags"].nbytes == 3 * ((n + 7) // 8)
    assert "scores" not in arrays  # they say no more than the flags
    for answer, flags in zip(unpack_answers(arrays), some, strict=True):
        np.testing.assert_array_equal(answer.flags, flags)
        np.testing.assert_array_equal(answer.scores, flags.astype(np.float32))


def test_no_queries_and_no_finds_are_answers_too() -> None:
    world = boxes()
    n = len(world.scene.gaussians)
    assert unpack_answers(pack_groundings([], n)) == []
    (answer,) = unpack_answers(pack_groundings([nothing_found(world.scene, None, 0.3)], n))
    assert not answer.flags.any() and answer.location is None and not answer.found
    assert answer.confidence == 0.3


def test_evidence_holds_every_virtual_views_camera_and_mask(answered) -> None:
    world, groundings = answered
    arrays = pack_groundings(groundings, len(world.scene.gaussians))
    assert arrays["evidence.query"].tolist() == [0] * 5 + [2] * 5
    assert arrays["evidence.role"].tolist() == [BEV, *[RING] * 4] * 2
    prefix = "evidence."
    names = {key.removeprefix(prefix): arrays[key] for key in arrays if key.startswith(prefix)}
    masks = PatchBook.from_arrays(names)
    views = [view for g in groundings for view in ([g.bev, *g.ring] if g.bev is not None else [])]
    for i, view in enumerate(views):
        size = tuple(int(side) for side in masks.sizes[i])
        camera = Camera(
            arrays["evidence.K"][i], arrays["evidence.world_to_camera"][i], size[1], size[0]
        )
        assert camera.K.tobytes() == view.frame.camera.K.tobytes()
        assert camera.world_to_camera.tobytes() == view.frame.camera.world_to_camera.tobytes()
        kept = masks.masks_of(i)
        assert len(kept) == int(view.mask is not None)
        if view.mask is not None:
            np.testing.assert_array_equal(kept[0].pixels, view.mask.pixels)
