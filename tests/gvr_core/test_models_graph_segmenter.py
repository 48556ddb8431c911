"""Graph-based segmentation: whole things on analytic frames, prompts, determinism, limits."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import skimage.data
from scipy import ndimage
from test_models_frames import (
    BOXES,
    FRONT,
    GROUND,
    LEFT,
    RIGHT,
    WALL,
    Box,
    above,
    camera_at,
    iou,
    middle,
    trace,
)

from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.models.base import Frame, Mask
from gvr_core.models.graph_segmenter import GraphSegmenter, GraphSettings
from gvr_core.rendering.base import get_renderer
from gvr_core.splat_io import read_splat

CAMERAS = {"front": FRONT, "left": LEFT, "right": RIGHT}


@pytest.fixture(scope="module")
def segmenter() -> GraphSegmenter:
    return GraphSegmenter()


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e4])
@pytest.mark.parametrize("name", CAMERAS)
def test_boxes_come_out_whole_whatever_the_unit(
    segmenter: GraphSegmenter, name: str, scale: float
) -> None:
    frame, shows = trace(CAMERAS[name], scale=scale)
    masks = segmenter.automatic(frame)
    for index in range(len(BOXES)):
        assert max(iou(m.pixels, shows == index) for m in masks) > 0.95
    for surface in (GROUND, WALL):
        assert max(iou(m.pixels, shows == surface) for m in masks) > 0.9


def test_noisy_depth_costs_little(segmenter: GraphSegmenter) -> None:
    frame, shows = trace(FRONT, depth_noise=0.003)
    masks = segmenter.automatic(frame)
    for index in range(len(BOXES)):
        assert max(iou(m.pixels, shows == index) for m in masks) > 0.9


@pytest.mark.parametrize("name", CAMERAS)
def test_a_point_on_a_box_gives_the_box(segmenter: GraphSegmenter, name: str) -> None:
    frame, shows = trace(CAMERAS[name])
    for index in range(len(BOXES)):
        found = segmenter.at_point(frame, middle(shows == index))
        assert iou(found.pixels, shows == index) > 0.95


@pytest.mark.parametrize("box", BOXES, ids=lambda box: box.photograph)
def test_from_above_a_point_gives_the_box_and_not_the_ground(
    segmenter: GraphSegmenter, box: Box
) -> None:
    camera = above(box)
    frame, shows = trace(camera)
    (x, y), _ = camera.project((*box.centre, box.size[2] / 2))
    found = segmenter.at_point(frame, (x, y))
    assert iou(found.pixels, shows == BOXES.index(box)) > 0.95


def test_from_above_a_tower_of_two_heights_is_one_thing(segmenter: GraphSegmenter) -> None:
    tower = (Box("cat", (0, 0), (0.6, 0.6, 0.2)), Box("rocket", (0, 0), (0.2, 0.2, 1.2)))
    frame, shows = trace(camera_at((0, 0, 3.5), (0, 0, 0)), tower)
    found = segmenter.at_point(frame, middle(shows == 1))
    assert iou(found.pixels, shows >= 0) > 0.95


def test_things_apart_in_depth_are_not_joined(segmenter: GraphSegmenter) -> None:
    pair = (Box("cat", (0, -0.8), (0.5, 0.3, 0.4)), Box("coffee", (0.2, 1.2), (0.6, 0.3, 1.0)))
    frame, shows = trace(camera_at((0, -3.5, 0.9)), pair)
    assert (shows == 0).any() and (shows == 1).any()
    for index in range(2):
        assert iou(segmenter.at_point(frame, middle(shows == index)).pixels, shows == index) > 0.9


def test_a_point_on_the_ground_gives_the_ground(segmenter: GraphSegmenter) -> None:
    frame, shows = trace(FRONT)
    found = segmenter.at_point(frame, (160.0, 232.0))
    assert shows[232, 160] == GROUND
    assert iou(found.pixels, shows == GROUND) > 0.9


def test_a_point_that_just_misses_still_gives_the_box(segmenter: GraphSegmenter) -> None:
    frame, shows = trace(above(BOXES[0]))
    rows, columns = np.nonzero(shows == 0)
    beside = (float(columns.max()) + 2.5, float(np.median(rows)) + 0.5)
    assert shows[int(beside[1]), int(beside[0])] == GROUND
    assert iou(segmenter.at_point(frame, beside).pixels, shows == 0) > 0.95


@pytest.mark.parametrize("point", [(-3.0, 10.0), (10.0, 1e6), (float("nan"), 4.0)])
def test_a_point_outside_gives_an_empty_mask(
    segmenter: GraphSegmenter, point: tuple[float, float]
) -> None:
    frame, _ = trace(FRONT)
    found = segmenter.at_point(frame, point)
    assert found.area == 0 and found.score == 0 and found.pixels.shape == frame.depth.shape


def test_a_box_prompt_gives_what_it_frames(segmenter: GraphSegmenter) -> None:
    frame, shows = trace(RIGHT)
    for index in range(len(BOXES)):
        truth = shows == index
        x0, y0, x1, y1 = Mask(truth).box
        found = segmenter.in_box(frame, (x0 - 3, y0 - 2, x1 + 2, y1 + 3))
        assert iou(found.pixels, truth) > 0.95


def test_a_box_prompt_beside_everything_is_empty(segmenter: GraphSegmenter) -> None:
    frame, shows = trace(FRONT, BOXES[:1], room=False)
    assert (shows[:10] != 0).all()
    assert segmenter.in_box(frame, (0, 0, 20, 10)).area == 0


def test_what_is_not_shown_is_in_no_mask(segmenter: GraphSegmenter) -> None:
    frame, shows = trace(LEFT, room=False)
    masks = segmenter.automatic(frame)
    assert masks
    for mask in masks:
        assert not mask.pixels[shows < 0].any()
    assert segmenter.at_point(frame, (2.0, 2.0)).area == 0


def test_a_lone_thing_is_one_mask(segmenter: GraphSegmenter) -> None:
    frame, shows = trace(
        camera_at((1.5, -1.5, 1.0), (0, 0, 0.3)), (Box("cat", (0, 0), (0.6,) * 3),), room=False
    )
    found = segmenter.at_point(frame, middle(shows == 0))
    assert iou(found.pixels, shows == 0) > 0.99
    assert max(iou(m.pixels, shows == 0) for m in segmenter.automatic(frame)) > 0.99


def test_nothing_shown_gives_no_mask(segmenter: GraphSegmenter) -> None:
    frame, _ = trace(FRONT, (), room=False)
    assert segmenter.automatic(frame) == []
    assert segmenter.at_point(frame, (50.0, 50.0)).area == 0
    assert segmenter.in_box(frame, (0, 0, 90, 90)).area == 0


def test_half_transparent_pixels_are_not_shown(segmenter: GraphSegmenter) -> None:
    frame, shows = trace(FRONT)
    assert frame.alpha is not None
    alpha = frame.alpha.copy()
    alpha[shows == WALL] = 0.3
    for mask in segmenter.automatic(replace(frame, alpha=alpha)):
        assert not mask.pixels[shows == WALL].any()


def test_masks_are_bounded_different_connected_and_in_order() -> None:
    settings = GraphSettings(min_score=0.0, max_masks=20, colour_scales=(50.0, 200.0))
    frame, _ = trace(FRONT)
    masks = GraphSegmenter(settings).automatic(frame)
    assert len(masks) == 20
    least = settings.min_share * frame.depth.size
    for i, mask in enumerate(masks):
        assert mask.pixels.dtype == np.bool_ and mask.area >= least - 1
        assert all(iou(mask.pixels, other.pixels) <= 0.9 for other in masks[:i])
        assert ndimage.label(mask.pixels)[1] == 1
    keys = [(-mask.level, -mask.area) for mask in masks]
    assert keys == sorted(keys)


def test_pieces_that_only_colour_sets_apart_are_left_to_prompts() -> None:
    frame, _ = trace(FRONT)
    every = GraphSegmenter(GraphSettings(min_score=0.0)).automatic(frame)
    default = GraphSegmenter().automatic(frame)
    assert {m.score >= 0.8 for m in default} == {True}
    assert len(default) < len(every)
    assert any(m.level == 0 for m in every)


def test_a_photograph_without_depth_is_cut_by_colour(segmenter: GraphSegmenter) -> None:
    rgb = (skimage.data.coffee()[::2, ::2] / 255).astype(np.float32)
    height, width = rgb.shape[:2]
    photo = Frame(
        rgb, np.zeros((height, width), np.float32), camera_at((0, -1, 0), size=(width, height))
    )
    masks = segmenter.automatic(photo)
    assert len(masks) > 1
    covered = np.logical_or.reduce([m.pixels for m in masks])
    assert covered.mean() > 0.9
    assert segmenter.at_point(photo, (150.0, 100.0)).pixels[100, 150]


def test_the_same_frame_gives_the_same_masks() -> None:
    frame, _ = trace(RIGHT, depth_noise=0.002)
    first, second = (GraphSegmenter().automatic(frame) for _ in range(2))
    assert len(first) == len(second)
    for a, b in zip(first, second, strict=True):
        assert np.array_equal(a.pixels, b.pixels) and (a.score, a.level) == (b.score, b.level)


def test_remembered_frames_are_not_mixed_up() -> None:
    segmenter = GraphSegmenter()
    frames = [trace(camera) for camera in (FRONT, LEFT, RIGHT, *map(above, BOXES))]
    for _ in range(2):
        for frame, shows in frames:
            seen = [i for i in range(len(BOXES)) if (shows == i).sum() > 1000]
            for index in seen:
                found = segmenter.at_point(frame, middle(shows == index))
                assert iou(found.pixels, shows == index) > 0.9


def test_the_answer_to_a_prompt_is_much_faster_than_the_first() -> None:
    segmenter = GraphSegmenter()
    frame, shows = trace(FRONT)
    start = time.process_time()
    segmenter.automatic(frame)
    first = time.process_time() - start
    start = time.process_time()
    segmenter.at_point(frame, middle(shows == 0))
    assert time.process_time() - start < first / 3


def test_the_name_tells_settings_apart() -> None:
    names = {
        GraphSegmenter(settings).name
        for settings in (GraphSettings(), GraphSettings(max_masks=9), GraphSettings(gap_limit=0.5))
    }
    assert len(names) == 3
    assert all(name.startswith("onboard-graph/") for name in names)


@pytest.mark.parametrize(
    ("name", "direction"),
    [
        ("guitar.ply", (1.0, 0.1, 0.2)),
        ("guitar.ply", (0.8, -0.3, 0.6)),
        ("biker.ply", (-1.0, -0.2, 0.3)),
        ("plant.splat", (1.0, -0.2, 0.3)),
    ],
)
def test_real_splats_come_out_whole(
    segmenter: GraphSegmenter, shared: Path, name: str, direction: tuple[float, float, float]
) -> None:
    gaussians = read_splat(shared / "data" / "splats" / name)
    low, high = np.percentile(gaussians.means, [1, 99], axis=0)
    centre, size = (low + high) / 2, float(np.linalg.norm(high - low))
    eye = centre + 1.6 * size * np.array(direction)
    camera = Camera(intrinsics(45, 320, 240), look_at(eye, centre, (0, -1, 0)), 320, 240)
    frame = Frame.of_rendering(get_renderer("numba").render(gaussians, camera), camera)
    assert frame.alpha is not None
    truth = (frame.alpha >= 0.5) & (frame.depth > 0)
    assert 0.01 < truth.mean() < 0.6
    assert iou(segmenter.at_point(frame, middle(truth)).pixels, truth) > 0.9
