"""Online segmentation: frustum filtering, virtual cameras, intersection."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_scene import UP, box, flat_gaussians

from gvr_core import paper
from gvr_core.cameras import Camera, birds_eye_camera, intrinsics, look_at, ring_cameras
from gvr_core.models.base import Frame, Mask
from gvr_core.segment import VirtualView, focus_point, frustum_filter, intersect, target_width

K = intrinsics(60, 40, 30)


def looking_from(eye: tuple[float, float, float]) -> Camera:
    return Camera(K, look_at(eye, (0, 0, 0), UP), 40, 30)


def virtual(camera: Camera, mask: np.ndarray | None) -> VirtualView:
    frame = Frame(np.zeros((30, 40, 3), np.float32), np.zeros((30, 40), np.float32), camera)
    return VirtualView(frame, None if mask is None else Mask(mask))


def slow_filter(points: np.ndarray, camera: Camera, mask: np.ndarray) -> list[bool]:
    """One Gaussian after the other, straight from the definition."""
    flags = []
    for point in points:
        x, y, z = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
        if z <= 0:
            flags.append(False)
            continue
        column = int(np.floor(camera.K[0, 0] * x / z + camera.K[0, 2]))
        row = int(np.floor(camera.K[1, 1] * y / z + camera.K[1, 2]))
        inside = 0 <= column < camera.width and 0 <= row < camera.height
        flags.append(bool(inside and mask[row, column]))
    return flags


@given(st.integers(0, 2**32 - 1))
def test_frustum_filter_equals_its_definition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    gaussians = flat_gaussians(rng.normal(size=(200, 3)) * 3, (1, 1, 1), 0.1)
    camera = looking_from((3.0, 1.0, 2.0))
    mask = rng.random((30, 40)) > 0.5
    flags = frustum_filter(gaussians, camera, mask)
    assert flags.tolist() == slow_filter(gaussians.means.astype(float), camera, mask)
    assert flags.any()
    assert not flags.all()


def test_gaussians_behind_the_camera_are_never_kept() -> None:
    camera = looking_from((3.0, 0.0, 0.0))
    gaussians = flat_gaussians(np.array([[0.0, 0, 0], [6.0, 0, 0]]), (1, 1, 1), 0.1)
    everything = np.ones((30, 40), np.bool_)
    assert frustum_filter(gaussians, camera, everything).tolist() == [True, False]


def test_intersection_keeps_what_every_view_keeps() -> None:
    gaussians = flat_gaussians(box((0, 0, 0), 1.0, 5), (1, 1, 1), 0.1)
    left = np.zeros((30, 40), np.bool_)
    left[:, :20] = True
    cameras = [looking_from((3.0, 0.0, 0.5)), looking_from((0.0, 3.0, 0.5))]
    coarse = np.ones(len(gaussians), np.bool_)
    coarse[:10] = False
    flags = intersect(gaussians, coarse, [virtual(c, left) for c in cameras])
    expected = coarse & frustum_filter(gaussians, cameras[0], left)
    expected &= frustum_filter(gaussians, cameras[1], left)
    assert flags.tolist() == expected.tolist()
    assert 0 < flags.sum() < coarse.sum()


def test_one_view_without_a_mask_empties_the_intersection() -> None:
    gaussians = flat_gaussians(box((0, 0, 0), 1.0, 3), (1, 1, 1), 0.1)
    whole = np.ones((30, 40), np.bool_)
    camera = looking_from((3.0, 0.0, 0.5))
    coarse = np.ones(len(gaussians), np.bool_)
    assert intersect(gaussians, coarse, [virtual(camera, whole)]).all()
    views = [virtual(camera, whole), virtual(camera, None)]
    assert not intersect(gaussians, coarse, views).any()


def test_birds_eye_camera_looks_straight_down_at_the_location() -> None:
    up = np.array([0.2, -0.9, 0.1])
    location = np.array([1.0, 2.0, 3.0])
    camera = birds_eye_camera(location, up, 2.5, K, 40, 30)
    np.testing.assert_allclose(camera.forward, -up / np.linalg.norm(up), atol=1e-12)
    pixel, z = camera.project(location)
    np.testing.assert_allclose(pixel, (20, 15), atol=1e-9)
    assert z == pytest.approx(2.5)


@given(st.integers(1, 9), st.floats(-60, 60), st.integers(0, 2**31))
def test_ring_cameras_stand_as_the_paper_says(k: int, pitch: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    up, location = rng.normal(size=3), rng.normal(size=3)
    up /= np.linalg.norm(up)
    cameras = ring_cameras(location, up, 2.0, pitch, k, K, 40, 30)
    offsets = np.stack([camera.position for camera in cameras]) - location
    np.testing.assert_allclose(np.linalg.norm(offsets, axis=1), 2.0)
    np.testing.assert_allclose(offsets @ up, 2.0 * np.sin(np.radians(pitch)), atol=1e-9)
    for camera in cameras:
        np.testing.assert_allclose(camera.project(location)[0], (20, 15), atol=1e-6)
    if k > 1:  # neighbours are one k-th of a turn apart
        level = offsets - np.outer(offsets @ up, up)
        level /= np.linalg.norm(level, axis=1, keepdims=True)
        cosines = (level * np.roll(level, 1, axis=0)).sum(axis=1)
        np.testing.assert_allclose(cosines, np.cos(2 * np.pi / k), atol=1e-9)


def test_the_papers_numbers() -> None:
    assert (paper.RING_VIEWS_K, paper.RING_DISTANCE_FACTOR) == (4, 3.0)
    assert (paper.RING_PITCH_DEGREES, paper.FEATURE_DIM_C) == (30.0, 512)


def test_width_is_horizontal_and_ignores_a_few_floaters() -> None:
    rng = np.random.default_rng(0)
    angle = 2 * np.pi * np.arange(4000) / 4000
    disc = np.stack([np.cos(angle), np.sin(angle), rng.uniform(-9, 9, 4000)], axis=1)
    disc[::100] *= 50
    assert target_width(disc.astype(np.float32), UP) == pytest.approx(2.0, rel=0.02)


def test_focus_point_is_where_the_axes_meet() -> None:
    goal = np.array([0.5, -1.0, 0.25])
    eyes = [(4, 0, 2), (0, 4, 1), (-3, 1, 3)]
    cameras = [Camera(K, look_at(eye, goal, UP), 40, 30) for eye in eyes]
    np.testing.assert_allclose(focus_point(cameras), goal, atol=1e-9)


def test_focus_point_of_parallel_axes_stays_near_the_cameras() -> None:
    cameras = [Camera(K, look_at((x, 0, 0), (x, 5, 0), UP), 40, 30) for x in (0.0, 2.0)]
    np.testing.assert_allclose(focus_point(cameras), (1, 0, 0), atol=1e-6)
