"""Regions of label pictures, their outlines, the layout of a frame, and the joining of surfaces."""

from __future__ import annotations

import numpy as np
import pytest
from test_models_frames import BOXES, FRONT, GROUND, LEFT, RIGHT, WALL, Box, above, camera_at, trace

from gvr_core.models.frame_geometry import FrameGeometry, frame_geometry
from gvr_core.models.outlines import outline_of
from gvr_core.models.regions import Region, dense_labels, regions_of
from gvr_core.models.things import merge_things


def region_of(pixels: np.ndarray) -> Region:
    """The one region of a mask."""
    (region,) = regions_of(pixels.astype(np.int64), pixels, 1)
    return region


def flat(disparity: np.ndarray, plane: np.ndarray | None = None) -> FrameGeometry:
    """A geometry made by hand."""
    planes = np.zeros(disparity.shape, np.uint8) if plane is None else plane.astype(np.uint8)
    return FrameGeometry(disparity > 0, disparity.astype(np.float32), planes, False)


def test_regions_are_connected_filled_and_sorted() -> None:
    labels = np.zeros((20, 30), np.int64)
    labels[2:12, 2:12] = 5
    labels[5, 5] = 7  # a hole of one pixel
    labels[2:6, 20:24] = 5  # the same label elsewhere
    labels[15, 3] = 9  # too small
    regions = regions_of(labels, labels > 0, 4)
    assert [r.area for r in regions] == [100, 16]
    assert (regions[0].top, regions[0].left, regions[1].top, regions[1].left) == (2, 2, 2, 20)
    expected = np.zeros((20, 30), np.bool_)
    expected[2:12, 2:12] = True
    assert np.array_equal(regions[0].whole((20, 30)), expected)


def test_a_large_hole_stays_open() -> None:
    labels = np.ones((20, 20), np.int64)
    labels[5:15, 5:15] = 2
    regions = regions_of(labels, np.ones((20, 20), np.bool_), 50)
    assert sorted(r.area for r in regions) == [100, 300]


def test_regions_never_reach_what_is_not_shown() -> None:
    shown = np.zeros((10, 10), np.bool_)
    shown[:, :4] = True
    (region,) = regions_of(np.ones((10, 10), np.int64), shown, 1)
    assert np.array_equal(region.whole((10, 10)), shown)


def test_overlap_of_regions_in_different_boxes() -> None:
    a, b, far = (np.zeros((12, 12), np.bool_) for _ in range(3))
    a[1:7, 1:7] = True
    b[4:10, 3:9] = True
    far[11, 11] = True
    assert region_of(a).overlap(region_of(b)) == np.count_nonzero(a & b) == 12
    assert region_of(a).iou(region_of(b)) == pytest.approx(12 / 60)
    assert region_of(a).overlap(region_of(far)) == 0


def test_outlines_tell_a_thing_from_its_background_and_from_a_piece_of_surface() -> None:
    disparity = np.full((40, 40), 0.5)
    disparity[10:30, 10:30] = 1.0
    thing, piece = np.zeros((2, 40, 40), np.bool_)
    thing[10:30, 10:30] = True
    piece[2:8, 2:20] = True
    geometry = flat(disparity)
    assert outline_of(region_of(thing), geometry) == (1.0, 1.0, 0.0)
    around = outline_of(region_of(~thing), geometry)
    assert around.closed == 1.0 and around.stands == 0.0
    assert outline_of(region_of(piece), geometry).closed == 0.0


def test_what_is_covered_from_the_front_still_stands() -> None:
    disparity = np.full((40, 40), 0.25)
    disparity[10:30, 10:30] = 0.5
    disparity[20:40, 5:35] = 1.0  # covers the lower half
    half = disparity == 0.5
    outline = outline_of(region_of(half), flat(disparity))
    assert outline.stands == 1.0 and outline.closed == 1.0


def test_a_mask_on_a_support_does_not_stand() -> None:
    plane = np.zeros((20, 20))
    plane[10:] = 1
    outline = outline_of(region_of(plane > 0), flat(np.ones((20, 20)), plane))
    assert outline.on_plane == 1.0 and outline.stands == 0.0 and outline.closed == 1.0


@pytest.mark.parametrize("camera", [FRONT, LEFT, RIGHT], ids=["front", "left", "right"])
def test_support_planes_are_the_ground_and_the_wall(camera) -> None:  # type: ignore[no-untyped-def]
    frame, shows = trace(camera)
    geometry = frame_geometry(frame)
    numbers = []
    for surface in (GROUND, WALL):
        values, counts = np.unique(geometry.plane[shows == surface], return_counts=True)
        assert counts.max() > 0.99 * counts.sum()
        numbers.append(values[counts.argmax()])
    assert set(numbers) == {1, 2}
    standing = np.mean(geometry.plane[shows >= 0] == 0)
    assert standing > 0.97
    assert not geometry.from_above


def test_a_view_from_above_is_known_as_one() -> None:
    frame, shows = trace(above(BOXES[1]))
    geometry = frame_geometry(frame)
    assert geometry.from_above
    assert set(np.unique(geometry.plane[shows == GROUND])) == {1}
    assert np.mean(geometry.plane[shows >= 0] == 0) > 0.99


def test_the_faces_of_a_lone_box_are_no_support() -> None:
    for eye in ((1.5, -1.5, 1.0), (0.1, -2.0, 0.3), (0.2, -1.0, 1.8)):
        camera = camera_at(eye, (0, 0, 0.3))
        frame, _ = trace(camera, (Box("cat", (0, 0), (0.6, 0.6, 0.6)),), room=False)
        assert not frame_geometry(frame).plane.any()


def test_disparity_has_no_unit() -> None:
    one, thousand = (frame_geometry(trace(FRONT, scale=s)[0]) for s in (1.0, 1000.0))
    np.testing.assert_allclose(one.disparity, thousand.disparity, rtol=1e-5)
    assert np.median(one.disparity[one.shown]) == pytest.approx(1, rel=1e-3)


def test_surfaces_join_when_their_gap_is_small_against_their_size() -> None:
    labels = np.zeros((30, 60), np.int64)
    labels[:, 20:40], labels[:, 40:] = 1, 2
    depth = np.choose(labels, [1.0, 1.05, 2.0])
    geometry = flat(1 / depth)
    # Sizes are about 0.25 (600 pixels, focal 100); gaps are 0.05 and 0.95.
    joined = merge_things(labels, geometry, 100.0, 0.75)
    assert len(np.unique(joined)) == 2
    assert joined[0, 0] == joined[0, 25] != joined[0, 50]
    assert len(np.unique(merge_things(labels, geometry, 100.0, 0.05))) == 3
    assert len(np.unique(merge_things(labels, geometry, 100.0, np.inf))) == 1


def test_surfaces_do_not_join_across_a_support_plane() -> None:
    labels = np.zeros((30, 60), np.int64)
    labels[:, 20:40], labels[:, 40:] = 1, 2
    geometry = flat(np.ones((30, 60)), labels == 1)
    assert len(np.unique(merge_things(labels, geometry, 100.0, np.inf))) == 3


@pytest.mark.parametrize("scale", [1, 3, 10**9])
def test_dense_labels_are_those_of_sorting(scale: int) -> None:
    labels = np.random.default_rng(scale).integers(-4, 40, (30, 50)) * scale
    labels[labels == 7 * scale] = 5 * scale
    _, twin = np.unique(labels, return_inverse=True)
    assert np.array_equal(dense_labels(labels), twin.reshape(labels.shape))
