"""The robust method, whole, with oracle models: what is judged here is its geometry."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from oracle_boxes import (
    ABSENT,
    BLUE,
    FLOOR,
    RED,
    Always,
    BlindOnce,
    World,
    boxes,
    boxes_and_floor,
    moved,
    twins,
)
from scipy.spatial.transform import Rotation
from small_scene import flat_gaussians, two_boxes

from gvr_core.books import Books
from gvr_core.gaussians import Gaussians
from gvr_core.methods.gvr_robust import GVRRobust
from gvr_core.metrics import flags_3d, iou
from gvr_core.models.base import Mask
from gvr_core.models.oracle import OracleTextSegmenter
from gvr_core.models.random_encoder import RandomEncoder
from gvr_core.robust.config import NEGATIVES, RobustConfig
from gvr_core.robust.relevancy import contrast, relevancy
from gvr_core.scene import Scene

SWITCHES = RobustConfig.switch_names()


@pytest.fixture(scope="module")
def world() -> World:
    return boxes()


@pytest.fixture(scope="module")
def books(world: World) -> Books:
    return world.method().prepare(world.scene)


@pytest.mark.parametrize("query", [RED, BLUE], ids=lambda q: q.id)
def test_true_masks_and_names_give_the_true_object(world, books, query) -> None:
    grounding = world.ground(books, query)
    means = world.scene.gaussians.means
    values = flags_3d(grounding.flags, world.truth(query), means, grounding.location)
    assert values["iou"] >= 0.9
    assert values["within_radius"] == 1.0
    assert grounding.found and grounding.confidence > 0.99
    assert len(grounding.instances) == 1 and len(grounding.ring) == 4
    assert set(grounding.seconds) == {
        *("BEV render", "BEV gate", "models", "retrieved views"),
        *("ring renders", "ring filters", "neighbours"),
    }
    assert ((grounding.scores >= 0.5) == grounding.flags).all()
    assert grounding.scores.min() >= 0 and grounding.scores.max() <= 1


def test_the_index_is_the_up_direction_and_what_may_be_drawn(world, books) -> None:
    assert set(books.index) == {"up", "steady"}
    assert books.index["up"] @ (0, 0, 1) > 0.9999
    assert books.index["steady"].dtype == np.bool_
    assert books.index["steady"].mean() > 0.99
    told = replace(world.scene, up=np.array([0.6, 0.0, 0.8]))
    np.testing.assert_array_equal(world.method().index(told, books)["up"], (0.6, 0, 0.8))


def test_switches_of_the_index_change_the_index_only_as_they_say(world, books) -> None:
    everything = world.method(robust={"floaters": False}).index(world.scene, books)
    assert everything["steady"].all() and not books.index["steady"].all()
    mean = world.method(robust={"ground_up": False}).index(world.scene, books)
    np.testing.assert_array_equal(mean["up"], world.scene.up_direction)
    assert not np.array_equal(mean["up"], books.index["up"])


def test_ground_is_locate_then_segment(world, books) -> None:
    method = world.method()
    place = method.locate(world.scene, books, RED)
    halves = method.segment(world.scene, books, place, RED)
    whole = method.ground(world.scene, books, RED)
    np.testing.assert_array_equal(halves.flags, whole.flags)
    np.testing.assert_array_equal(halves.scores, whole.scores)
    np.testing.assert_array_equal(halves.location, whole.location)


ROUGH = {"soft_vote", "cleanup"}
"""Without these the inside of an object, which no view has seen, is not part of the answer."""


@pytest.mark.parametrize("switch", SWITCHES)
def test_each_part_can_be_left_out(world, books, switch) -> None:
    for query in (RED, BLUE):
        grounding = world.ground(books, query, robust={switch: False})
        truth = world.truth(query)
        assert grounding.found and len(grounding.instances) == 1
        assert iou(grounding.flags, truth) >= (0.5 if switch in ROUGH else 0.9)
        assert truth[grounding.flags].mean() >= 0.95
    absent = world.ground(books, ABSENT, robust={switch: False})
    assert absent.found == (switch == "refusal")


def test_relevancy_is_against_phrases_where_the_switch_and_the_encoder_have_it(
    world, books
) -> None:
    encoder = RandomEncoder(1, 8)
    patches = books.semantics.patches
    rows = np.random.default_rng(0).normal(size=(len(patches), 8)).astype(np.float32)
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    mixed = replace(books, semantics=replace(books.semantics, features=rows))
    cosines = rows @ encoder.encode_texts([RED.text, *NEGATIVES]).T
    against = relevancy(cosines[:, 0], cosines[:, 1:].T, 10.0)
    typical = contrast(cosines[:, 0], 10.0)
    for switches, expected in (
        ({}, against),
        ({"phrases": True}, against),
        ({"phrases": False}, typical),
        ({"canonical_negatives": False}, typical),
        ({"canonical_negatives": False, "phrases": True}, typical),
    ):
        config = RobustConfig(refusal=False, several_patches=False, **switches)
        tools = world.method().tools
        models = replace(tools.models, encoder=encoder)
        found = GVRRobust(replace(tools, models=models), config).locate(world.scene, mixed, RED)
        retrieval = found.retrieval
        np.testing.assert_allclose(retrieval.relevancies, expected[retrieval.patches], rtol=1e-5)
        best = [expected[a:b].max() for a, b in itertools.pairwise(patches.view_ptr)]
        np.testing.assert_array_equal(retrieval.relevancies, np.float32(best))


def test_with_every_part_left_out_it_is_no_worse_than_the_papers(world, books) -> None:
    off = {"robust": dict.fromkeys(SWITCHES, False)}
    for query in (RED, BLUE):
        bare = world.ground(books, query, **off)
        paper = world.method("gvr-paper").ground(world.scene, books, query)
        truth = world.truth(query)
        assert iou(bare.flags, truth) >= iou(paper.flags, truth) - 0.02


@pytest.mark.parametrize("blind", range(4))
def test_a_blind_ring_view_costs_little_and_empties_an_intersection(world, books, blind) -> None:
    seeing = OracleTextSegmenter(world.oracle)
    truth = world.truth(RED)
    for switch, cost in ((None, 0.05), ("retrieved_views", 0.05)):
        off = {} if switch is None else {switch: False}
        whole = world.ground(books, RED, robust=off)
        found = world.ground(books, RED, text_segmenter=BlindOnce(seeing, blind), robust=off)
        assert [view.mask is None for view in found.ring] == [i == blind for i in range(4)]
        assert iou(whole.flags, truth) - iou(found.flags, truth) < cost
    hard = BlindOnce(seeing, blind)
    empty = world.ground(books, RED, text_segmenter=hard, robust={"soft_vote": False})
    assert not empty.found and not empty.flags.any() and empty.instances == ()


def test_without_a_say_of_any_view_the_coarse_set_is_the_answer(world, books) -> None:
    nothing = Always(None)
    off = {"retrieved_views": False, "bev_gate": False, "bev_clip": False, "weight_filter": False}
    found = world.ground(books, RED, text_segmenter=nothing, robust=off)
    assert all(view.mask is None for view in found.ring) and found.bev is not None
    np.testing.assert_array_equal(found.scores, found.flags.astype(np.float32))
    # the column under the bird's-eye mask: all of the box, and the floor under it
    assert found.flags[world.truth(RED)].mean() > 0.9
    assert not found.flags[world.truth(BLUE)].any()


def test_a_ring_detection_beside_the_object_counts_as_none(world, books) -> None:
    corner = np.zeros((72, 96), np.bool_)
    corner[:12, :12] = True
    whole = world.ground(books, RED, text_segmenter=Always(None))
    misled = world.ground(books, RED, text_segmenter=Always(Mask(corner)))
    assert all(view.mask is None for view in misled.ring)
    np.testing.assert_array_equal(misled.flags, whole.flags)
    believed = world.ground(
        books, RED, text_segmenter=Always(Mask(corner)), robust={"agree_iou": 0.0}
    )
    assert all(view.mask is not None for view in believed.ring)
    assert iou(believed.flags, world.truth(RED)) < iou(whole.flags, world.truth(RED))


def test_what_is_not_there_is_refused(world, books) -> None:
    grounding = world.ground(books, ABSENT)
    assert not grounding.found and not grounding.flags.any() and not grounding.scores.any()
    assert grounding.location is None and grounding.instances == ()
    assert grounding.confidence <= 0.55
    assert grounding.localization is not None and grounding.localization.places == ()
    nothing = world.method().segment(world.scene, books, None, RED)
    assert not nothing.found and nothing.confidence == 0.0


def test_both_twins_are_returned_or_on_demand_one() -> None:
    pair = twins()
    books = pair.method().prepare(pair.scene)
    both = pair.ground(books, RED)
    left = pair.truth(RED) & (pair.scene.gaussians.means[:, 0] < 0)
    right = pair.truth(RED) & ~left
    assert len(both.instances) == 2
    for twin in (left, right):
        assert max(iou(instance, twin) for instance in both.instances) >= 0.85
    np.testing.assert_array_equal(both.flags, both.instances[0] | both.instances[1])
    assert ((both.scores >= 0.5) == both.flags).all()
    one = pair.ground(books, RED, robust={"all_instances": False})
    assert len(one.instances) == 1
    assert max(iou(one.flags, twin) for twin in (left, right)) >= 0.85


def test_an_area_is_lifted_from_the_views() -> None:
    world = boxes_and_floor()
    books = world.method().prepare(world.scene)
    area = world.ground(books, FLOOR)
    assert area.localization is not None and area.localization.is_stuff
    assert area.bev is None and len(area.ring) == 0
    assert iou(area.flags, world.truth(FLOOR)) >= 0.85
    as_thing = world.ground(books, FLOOR, robust={"stuff": False})
    assert as_thing.localization is not None and not as_thing.localization.is_stuff
    assert len(as_thing.ring) == 4


@pytest.mark.parametrize("gate", [True, False])
def test_a_hundredfold_scene_gives_the_same_flags(world, books, gate) -> None:
    large = moved(world, scale=100.0)
    large_books = large.method().prepare(large.scene)
    for query in (RED, BLUE):
        off = {"robust": {"bev_gate": gate}}
        here, there = world.ground(books, query, **off), large.ground(large_books, query, **off)
        # float32 rounds differently in another unit, so votes on the fence may tip
        assert iou(here.flags, there.flags) >= 0.99
        assert there.location == pytest.approx(100 * here.location, rel=1e-3)


@pytest.mark.parametrize("seed", [3, 5])
def test_a_turned_scene_gives_the_same_flags(world, books, seed) -> None:
    turn = Rotation.random(random_state=seed).as_matrix()
    other = moved(world, turn, shift=(30.0, -50.0, 7.0))
    other_books = other.method().prepare(other.scene)
    assert other_books.index["up"] @ turn[:, 2] > 0.9999
    for query in (RED, BLUE):
        here, there = world.ground(books, query), other.ground(other_books, query)
        # the ring begins at another yaw, so the votes are not the same to the last one
        assert iou(here.flags, there.flags) >= 0.95
        assert iou(there.flags, world.truth(query)) >= 0.9


def test_what_hangs_in_the_air_does_not_hide_the_object_from_above(world) -> None:
    """Solid clots between the cameras and the sky: the view from above is drawn without them."""
    scene: Scene = world.scene
    means = np.array([(x, 0.2, 3.0) for x in np.linspace(-1.5, 1.5, 6)])
    clots = flat_gaussians(means, (0.0, 1.0, 0.0), 0.3)
    hung = World(
        replace(scene, gaussians=Gaussians.concatenate([scene.gaussians, clots])),
        np.append(world.labels, np.full(6, -1)).astype(np.int16),
    )
    hung_books = hung.method().prepare(hung.scene)
    assert not hung_books.index["steady"][-6:].any()
    off = {"bev_gate": False, "bev_clip": False}
    for floaters, hidden in ((True, False), (False, True)):
        found = hung.ground(hung_books, RED, robust={**off, "floaters": floaters})
        assert found.bev is not None and found.bev.mask is not None
        shown = found.bev.frame.shown
        assert shown is not None and shown[-6:].all() == hidden
        assert (found.bev.frame.rgb[..., 1] > 0.6).any() == hidden
    assert not hung.ground(hung_books, RED).flags[-6:].any()


@pytest.mark.parametrize("n_views", [2, 3, 4])
def test_few_views_from_all_around_are_enough(n_views: int) -> None:
    """Every view shows the box, and is sure of it; the paper's method finds it."""
    few = World(*two_boxes(n_views))
    few_books = few.method().prepare(few.scene)
    assert few.method("gvr-paper").ground(few.scene, few_books, RED).found
    assert few.ground(few_books, RED).found
