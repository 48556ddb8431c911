"""Models that know the truth: true masks, true names, and nothing of what is not there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracle_boxes import ABSENT, BLUE, RED, World, boxes, twins
from small_scene import OBJECTS, box, flat_gaussians

from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.errors import ConfigError
from gvr_core.gaussians import Gaussians
from gvr_core.models.base import Frame, Mask
from gvr_core.models.conse import ConseEncoder
from gvr_core.models.oracle import (
    ABSENT_AXIS,
    BACKGROUND_AXIS,
    MIN_AREA,
    OracleEncoder,
    OracleSegmenter,
    OracleTextSegmenter,
    OracleWorld,
    oracle_models,
)
from gvr_core.models.registry import ModelConfig, build_models, check_models, needs_world
from gvr_core.rendering import get_renderer

H, W = 72, 96


@pytest.fixture(scope="module")
def world() -> World:
    return boxes()


def frame_of(world: World, shown: np.ndarray | None = None, view: int = 2) -> Frame:
    camera = world.scene.views[view].camera
    drawn = world.scene.gaussians if shown is None else world.scene.gaussians.subset(shown)
    return Frame.of_rendering(get_renderer("numba").render(drawn, camera), camera, shown)


def silhouette(world: World, flags: np.ndarray, view: int = 2) -> np.ndarray:
    """Where an object's share of the light is more than half, drawn with all else black."""
    white = np.repeat(flags[:, None], 3, axis=1).astype(np.float32)
    camera = world.scene.views[view].camera
    drawn = world.scene.gaussians.recoloured(white)
    return get_renderer("numba").render(drawn, camera).rgb[..., 0] > 0.5


def test_patches_are_the_objects_and_the_rest(world) -> None:
    frame = frame_of(world)
    red, blue, rest = OracleSegmenter(world.oracle).automatic(frame)
    np.testing.assert_array_equal(red.pixels, silhouette(world, world.truth(RED)))
    np.testing.assert_array_equal(blue.pixels, silhouette(world, world.truth(BLUE)))
    assert red.area > 100 and blue.area > 100
    np.testing.assert_array_equal(rest.pixels, ~(red.pixels | blue.pixels))


def test_only_what_is_drawn_is_there(world) -> None:
    frame = frame_of(world, world.truth(BLUE))
    alone, _ = OracleSegmenter(world.oracle).automatic(frame)
    whole = OracleSegmenter(world.oracle).automatic(frame_of(world))[1]
    assert (alone.pixels | ~whole.pixels).all()
    text = OracleTextSegmenter(world.oracle)
    assert text.segment(frame, RED.text) is None
    found = text.segment(frame, BLUE.text)
    assert found is not None
    np.testing.assert_array_equal(found.pixels, alone.pixels)


def test_a_point_gets_its_piece_or_all_that_is_no_object(world) -> None:
    frame, segmenter = frame_of(world), OracleSegmenter(world.oracle)
    red, _, rest = segmenter.automatic(frame)
    rows, columns = np.nonzero(red.pixels)
    inside = (float(columns[50]) + 0.9, float(rows[50]) + 0.1)
    np.testing.assert_array_equal(segmenter.at_point(frame, inside).pixels, red.pixels)
    np.testing.assert_array_equal(segmenter.at_point(frame, (0.5, H - 0.5)).pixels, rest.pixels)
    for outside in [(-0.1, 5.0), (W + 0.1, 5.0), (5.0, -3.0), (5.0, float(H))]:
        missed = segmenter.at_point(frame, outside)
        assert missed.area == 0 and missed.score == 0.0


def test_a_box_gets_the_piece_that_fits_it_best(world) -> None:
    frame, segmenter = frame_of(world), OracleSegmenter(world.oracle)
    red, blue, rest = segmenter.automatic(frame)
    for mask in (red, blue):
        x0, y0, x1, y1 = mask.box
        near = (x0 - 1.5, y0 + 1.0, x1 + 0.5, y1 - 1.0)
        np.testing.assert_array_equal(segmenter.in_box(frame, near).pixels, mask.pixels)
    np.testing.assert_array_equal(segmenter.in_box(frame, (0, 0, W, H)).pixels, rest.pixels)
    assert segmenter.in_box(frame, (-20, -20, -5, -5)).area == 0


def test_each_object_has_an_axis_and_two_are_for_all_else(world) -> None:
    frame, encoder = frame_of(world), OracleEncoder(world.oracle)
    assert encoder.dim == 4
    nothing = Mask(np.zeros((H, W), np.bool_))
    masks = [*OracleSegmenter(world.oracle).automatic(frame), nothing]
    axes = np.eye(4, dtype=np.float32)
    features = encoder.encode_patches(frame, masks)
    assert features.dtype == np.float32
    np.testing.assert_array_equal(features, axes[[0, 1, BACKGROUND_AXIS, BACKGROUND_AXIS]])
    texts = encoder.encode_texts([BLUE.text, RED.text, ABSENT.text, "red box", ""])
    # the name of an object is no text unless the queries say so
    np.testing.assert_array_equal(texts, axes[[1, 0, ABSENT_AXIS, ABSENT_AXIS, ABSENT_AXIS]])
    assert encoder.encode_patches(frame, []).shape == (0, 4)
    assert not (features @ encoder.encode_texts([ABSENT.text]).T).any()


def test_a_patch_is_what_covers_more_than_half_of_it(world) -> None:
    frame, encoder = frame_of(world), OracleEncoder(world.oracle)
    red = OracleSegmenter(world.oracle).automatic(frame)[0].pixels
    rows, columns = np.nonzero(~red & (np.arange(W) < 20))
    for extra, axis in ((0.9, 0), (1.1, BACKGROUND_AXIS)):
        mixed = red.copy()
        n = round(extra * np.count_nonzero(red))
        mixed[rows[:n], columns[:n]] = True
        assert np.count_nonzero(mixed) == np.count_nonzero(red) + n
        np.testing.assert_array_equal(
            encoder.encode_patches(frame, [Mask(mixed)])[0], np.eye(4)[axis]
        )


def test_a_text_gets_all_pixels_of_what_it_means_or_nothing(world) -> None:
    text, frame = OracleTextSegmenter(world.oracle), frame_of(world)
    found = text.segment(frame, RED.text)
    assert found is not None
    np.testing.assert_array_equal(found.pixels, silhouette(world, world.truth(RED)))
    assert text.segment(frame, ABSENT.text) is None
    eye = (0.0, 0.0, 9.0)
    away = Camera(intrinsics(60, W, H), look_at(eye, (0, 0, 20), (0, 1, 0)), W, H)
    assert text.segment(replace(frame, camera=away), RED.text) is None


def test_twins_are_two_patches_and_leaves_are_one() -> None:
    pair = twins()
    masks = OracleSegmenter(pair.oracle).automatic(frame_of(pair))
    both = OracleTextSegmenter(pair.oracle).segment(frame_of(pair), RED.text)
    assert len(masks) == 3 and both is not None
    np.testing.assert_array_equal(masks[0].pixels | masks[1].pixels, both.pixels)
    # one object of three slabs with gaps of about a pixel between them
    slabs = [box((0, 0, z), 0.5, 10) * (1, 1, 0.2) + (0, 0, 0.8 * z) for z in (0.0, 0.19, 0.38)]
    parts = [flat_gaussians(slab, (1, 0, 0), 0.02) for slab in slabs]
    gaussians = Gaussians.concatenate(parts)
    labels = np.zeros(len(gaussians), np.int16)
    one = World(replace(pair.scene, gaussians=gaussians), labels, OBJECTS)
    leaves = OracleSegmenter(one.oracle).automatic(frame_of(one))
    assert len(leaves) == 2
    assert leaves[0].area > MIN_AREA


def test_specks_are_no_patches_but_a_point_on_one_finds_it() -> None:
    world = boxes()
    speck = flat_gaussians(np.array([(0.0, -1.5, 1.0)]), (0, 1, 0), 0.06)
    scene = replace(world.scene, gaussians=Gaussians.concatenate([world.scene.gaussians, speck]))
    three = World(scene, np.append(world.labels, 2).astype(np.int16), (*OBJECTS, "floor"))
    frame, segmenter = frame_of(three, view=0), OracleSegmenter(three.oracle)
    truth = silhouette(three, three.labels == 2, view=0)
    assert 0 < np.count_nonzero(truth) < MIN_AREA
    assert len(segmenter.automatic(frame)) == 3
    row, column = (int(x[0]) for x in np.nonzero(truth))
    np.testing.assert_array_equal(segmenter.at_point(frame, (column, row)).pixels, truth)


def test_more_objects_than_a_picture_has_channels() -> None:
    """Seven boxes in a row, each found under its own name."""
    names = tuple(f"box {i}" for i in range(7))
    parts = [flat_gaussians(box((0.6 * i - 1.8, 0, 0), 0.4, 6), (1, 1, 1), 0.05) for i in range(7)]
    gaussians = Gaussians.concatenate(parts)
    labels = np.repeat(np.arange(7), 216).astype(np.int16)
    world = OracleWorld(gaussians, labels, names, {name: name for name in names})
    camera = Camera(intrinsics(60, W, H), look_at((0, -5, 0), (0, 0, 0), (0, 0, 1)), W, H)
    frame = Frame.of_rendering(get_renderer("numba").render(gaussians, camera), camera)
    shares = world.shares(frame)
    assert shares.shape == (7, H, W)
    np.testing.assert_allclose(shares.sum(axis=0), frame.alpha, atol=1e-3)
    models = oracle_models(world)
    middles = []
    for name in names:
        mask = models.text_segmenter.segment(frame, name)
        assert mask is not None
        middles.append(np.nonzero(mask.pixels)[1].mean())
    assert (np.diff(middles) > 5).all()


def test_the_name_says_oracle_and_which_truth(world) -> None:
    plain, told = world.oracle, replace(world.oracle, digest="ab" * 32)
    assert plain.name == "oracle/1" and told.name == f"oracle/1({'ab' * 8},numba)"
    assert replace(told, renderer="torch-reference").name != told.name
    models = oracle_models(told)
    names = {models.segmenter.name, models.encoder.name, models.text_segmenter.name}
    assert names == {told.name}


ROLES = ("segmenter", "encoder", "text_segmenter")


@pytest.mark.parametrize("role", ROLES)
def test_an_oracle_needs_a_truth_and_takes_its_own_role_alone(world, role) -> None:
    config = ModelConfig.model_validate({"encoder": "random:0", role: "oracle"})
    assert needs_world(config)
    check_models(config)
    with pytest.raises(ConfigError, match="labelled"):
        build_models(config)
    models = build_models(config, world.oracle)
    told = {name for name in ROLES if getattr(models, name).name == world.oracle.name}
    assert told == {role}


def test_a_truth_at_hand_is_not_told_to_other_models(world) -> None:
    config = ModelConfig(encoder="onboard-conse")
    assert not needs_world(config)
    models = build_models(config, world.oracle)
    assert isinstance(models.encoder, ConseEncoder)
    assert all("oracle" not in getattr(models, role).name for role in ROLES)
