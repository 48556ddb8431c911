"""The up direction from what the cameras see, on depth traced by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gvr_core.books import DepthBook
from gvr_core.cameras import Camera, intrinsics, look_at, up_vector
from gvr_core.robust.ground_plane import ground_up
from gvr_core.scene import View

SIZE = (48, 64)
UP = np.array([0.0, 0.0, 1.0])

Plane = tuple[Sequence[float], float, Callable[[np.ndarray], np.ndarray] | None]
"""Normal n, offset d with n x = d, and which of its points are there; None for all."""
GROUND: Plane = (UP, 0.0, None)


def depth_of(camera: Camera, planes: Sequence[Plane]) -> np.ndarray:
    """z-depth (H, W) of the nearest plane in every pixel; 0 where there is none."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1)
    rays = camera.unproject(pixels, np.ones(len(pixels))) - camera.position
    best = np.full(len(rays), np.inf)
    for normal, offset, there in planes:
        n = np.asarray(normal, np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            z = (offset - camera.position @ n) / (rays @ n)
        points = camera.position + np.nan_to_num(z, posinf=0, neginf=0)[:, None] * rays
        hit = np.isfinite(z) & (z > 0.05) & (z < 60) & (z < best)
        if there is not None:
            hit &= there(points)
        best[hit] = z[hit]
    return np.where(np.isfinite(best), best, 0).reshape(SIZE).astype(np.float32)


def seen(
    eyes: Sequence[Sequence[float]],
    targets: Sequence[Sequence[float]],
    planes: Sequence[Plane],
    fov: float = 70.0,
    noise: float = 0.0,
) -> tuple[list[View], DepthBook]:
    """Views, and the depth that they see of the planes."""
    rng = np.random.default_rng(7)
    K = intrinsics(fov, SIZE[1], SIZE[0])
    views, depths = [], []
    for i, (eye, target) in enumerate(zip(eyes, targets, strict=True)):
        camera = Camera(K, look_at(eye, target, UP), SIZE[1], SIZE[0])
        views.append(View(f"v{i}", camera))
        depths.append(depth_of(camera, planes).ravel() * (1 + noise * rng.normal(size=48 * 64)))
    flat = np.concatenate(depths).astype(np.float32)
    nothing = np.zeros_like(flat)
    return views, DepthBook(nothing, flat, np.array([SIZE] * len(views), np.int32))


def one_sided(pitch: float, planes: Sequence[Plane], **more: float):
    """Eight cameras in a row that all look along +y, so many degrees down."""
    down = np.radians(pitch)
    eyes = [(x, 0.0, 3.0) for x in np.linspace(-2, 2, 8)]
    targets = [(x, np.cos(down), 3.0 - np.sin(down)) for x, _, _ in eyes]
    return seen(eyes, targets, planes, **more)


def degrees_off(direction: np.ndarray) -> float:
    assert np.linalg.norm(direction) == pytest.approx(1.0)
    return float(np.degrees(np.arccos(np.clip(direction @ UP, -1, 1))))


def mean_up(views: Sequence[View]) -> np.ndarray:
    return up_vector([view.camera for view in views]).direction


@pytest.mark.parametrize("pitch", [10.0, 25.0, 40.0])
@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_cameras_that_all_lean_one_way_do_not_tilt_up(pitch: float, noise: float) -> None:
    views, depths = one_sided(pitch, [GROUND], noise=noise)
    assert degrees_off(mean_up(views)) == pytest.approx(pitch, abs=0.1)
    assert degrees_off(ground_up(views, depths)) < (0.01 if noise == 0 else 0.3)


def test_it_is_the_same_twice_and_in_any_frame_and_unit() -> None:
    views, depths = one_sided(30.0, [GROUND], noise=0.01)
    first = ground_up(views, depths)
    np.testing.assert_array_equal(ground_up(views, depths), first)
    turn = Rotation.random(random_state=1).as_matrix()
    others = []
    for view in views:
        matrix = np.eye(4)
        matrix[:3, :3] = view.camera.world_to_camera[:3, :3] @ turn.T
        matrix[:3, 3] = 100 * view.camera.world_to_camera[:3, 3]
        others.append(View(view.name, Camera(view.camera.K, matrix, SIZE[1], SIZE[0])))
    large = DepthBook(depths.expected, depths.median * np.float32(100), depths.sizes)
    np.testing.assert_allclose(ground_up(others, large), turn @ first, atol=1e-3)


def test_a_wall_is_no_ground() -> None:
    """It fills most of the picture, and the ground the rest."""
    wall: Plane = ((0, -1, 0), -9.0, None)
    views, depths = one_sided(10.0, [GROUND, wall])
    share = np.mean([abs(p[1] - 9) < 0.01 for p in points_of(views, depths)])
    assert share > 0.6
    assert degrees_off(ground_up(views, depths)) < 0.01


def points_of(views: Sequence[View], depths: DepthBook) -> np.ndarray:
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1)
    return np.concatenate(
        [
            view.camera.unproject(pixels, depths.depth(i, "median").ravel())
            for i, view in enumerate(views)
        ]
    )


def test_a_wall_alone_leaves_the_word_to_the_cameras() -> None:
    views, depths = one_sided(10.0, [((0, -1, 0), -9.0, None)])
    np.testing.assert_array_equal(ground_up(views, depths), mean_up(views))


def test_a_slanted_ceiling_with_the_room_beneath_it_is_no_ground() -> None:
    slant = np.radians(20)
    ceiling: Plane = ((-np.sin(slant), 0, np.cos(slant)), 4.5 * np.cos(slant), None)
    eyes = [(x, 0.0, 2.0) for x in np.linspace(-1, 1, 6)]
    targets = [(x, 1.0, 2.25) for x, _, _ in eyes]
    views, depths = seen(eyes, targets, [GROUND, ceiling], fov=90)
    points = points_of(views, depths)
    on_ceiling = np.mean(np.abs(points @ np.asarray(ceiling[0]) - ceiling[1]) < 0.01)
    on_ground = np.mean(np.abs(points[:, 2]) < 0.01)
    assert on_ceiling > 1.2 * on_ground > 0.2
    assert degrees_off(ground_up(views, depths)) < 0.01
    # with nothing beneath it, the same plane is taken for the ground
    views, depths = seen(eyes, targets, [ceiling], fov=90)
    assert degrees_off(ground_up(views, depths)) == pytest.approx(20, abs=0.01)


def test_a_tilted_table_top_does_not_tilt_the_world() -> None:
    """It carries more points than the ground, which lies beneath it."""
    tilt = np.radians(12)
    normal = np.array([0.0, -np.sin(tilt), np.cos(tilt)])

    def top(points: np.ndarray) -> np.ndarray:
        return (np.abs(points[:, 0]) < 2.2) & (points[:, 1] > 1.0) & (points[:, 1] < 4.5)

    views, depths = one_sided(40.0, [GROUND, (normal, normal @ (0, 3, 1.0), top)])
    points = points_of(views, depths)
    on_top = np.mean(np.abs(points @ normal - normal @ (0, 3, 1.0)) < 0.01)
    on_ground = np.mean(np.abs(points[:, 2]) < 0.01)
    assert on_top > on_ground > 0.2
    assert degrees_off(ground_up(views, depths)) < 0.01


def test_without_a_plane_or_any_depth_the_cameras_decide() -> None:
    views, depths = one_sided(30.0, [GROUND])
    rng = np.random.default_rng(0)
    ragged = rng.uniform(2, 9, depths.median.shape).astype(np.float32)
    mean = mean_up(views)
    for median in (ragged, np.zeros_like(ragged)):
        book = DepthBook(depths.expected, median, depths.sizes)
        np.testing.assert_array_equal(ground_up(views, book), mean)


def test_holes_in_the_depth_are_no_points() -> None:
    views, depths = one_sided(30.0, [GROUND])
    rng = np.random.default_rng(0)
    holes = np.where(rng.random(depths.median.shape) < 0.7, 0, depths.median).astype(np.float32)
    found = ground_up(views, DepthBook(depths.expected, holes, depths.sizes))
    assert degrees_off(found) < 0.01
