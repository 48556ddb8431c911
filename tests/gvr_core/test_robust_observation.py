"""How much of a bird's-eye mask cameras have seen from above, point by point."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from small_scene import flat_gaussians

from gvr_core.books import DepthBook
from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.models.base import Frame
from gvr_core.robust.observation import observed_share
from gvr_core.scene import Scene, View

W, H = 64, 48
K = intrinsics(60, W, H)
UP = (0.0, 0.0, 1.0)
TOP = 1.0
"""Height of the flat top that is asked about."""


def camera(eye: Sequence[float], target: Sequence[float] = (0, 0, TOP)) -> Camera:
    return Camera(K, look_at(eye, target, UP), W, H)


def around(pitch: float, n: int = 4, distance: float = 5.0) -> list[Camera]:
    """Cameras that look at the top from so many degrees above the horizontal."""
    angle = np.radians(pitch)
    return [
        camera(
            (
                distance * np.cos(angle) * np.cos(yaw),
                distance * np.cos(angle) * np.sin(yaw),
                TOP + distance * np.sin(angle),
            )
        )
        for yaw in 2 * np.pi * np.arange(n) / n
    ]


def top_depth(view: Camera) -> np.ndarray:
    """z-depth (H, W) of the plane z = TOP, 0 where a ray misses it."""
    rows, columns = np.mgrid[:H, :W] + 0.5
    rays = view.unproject(np.stack([columns, rows], axis=-1), np.ones((H, W))) - view.position
    with np.errstate(divide="ignore"):
        z = (TOP - view.position[2]) / rays[..., 2]
    return np.where(np.isfinite(z) & (z > 0), z, 0).astype(np.float32)


def share(
    cameras: Sequence[Camera],
    mask: np.ndarray,
    most_degrees: float = 60.0,
    depths: Sequence[np.ndarray] | None = None,
    bev_depth: np.ndarray | None = None,
) -> float:
    scene = Scene(
        "test",
        "top",
        flat_gaussians(np.zeros((1, 3)), (1, 1, 1), 0.1),
        tuple(View(f"v{i}", c) for i, c in enumerate(cameras)),
    )
    seen = [top_depth(c) for c in cameras] if depths is None else depths
    flat = np.concatenate([d.ravel() for d in seen]).astype(np.float32)
    book = DepthBook(np.zeros_like(flat), flat, np.array([(H, W)] * len(cameras), np.int32))
    above = camera((0, 0, TOP + 5))
    z = top_depth(above) if bev_depth is None else bev_depth
    frame = Frame(np.zeros((H, W, 3), np.float32), z, above)
    return observed_share(scene, book, frame, mask, most_degrees)


def middle(width: int = 16) -> np.ndarray:
    mask = np.zeros((H, W), np.bool_)
    mask[16:32, 32 - width // 2 : 32 + width // 2] = True
    return mask


def test_a_top_is_seen_by_steep_cameras_and_not_from_the_side() -> None:
    assert share(around(60), middle()) == 1.0
    assert share(around(15), middle()) == 0.0
    assert share(around(15), middle(), most_degrees=90) == 1.0
    # 45 degrees above the horizontal is 45 from straight above
    assert share(around(45), middle(), most_degrees=55) == 1.0
    assert share(around(45), middle(), most_degrees=35) == 0.0


def test_cameras_below_see_no_top() -> None:
    below = around(-60)
    assert share(below, middle()) == 0.0
    # whatever their depth pictures say
    wrong = [np.full((H, W), 9.0, np.float32)] * len(below)
    assert share(below, middle(), depths=wrong) == 0.0


def test_one_camera_is_not_enough() -> None:
    assert share(around(60)[:1], middle()) == 0.0
    assert share(around(60)[:2], middle()) == 1.0
    assert share([*around(60)[:1], *around(10)], middle()) == 0.0


def test_each_point_counts_by_what_stands_before_it() -> None:
    """Something before the left half of the top in one of two cameras, then in three of four."""
    mask = middle()
    two, four = around(80)[:2], around(80)

    def hidden(view: Camera, factor: float = 0.5) -> np.ndarray:
        depth = top_depth(view)
        rows, columns = np.mgrid[:H, :W] + 0.5
        points = view.unproject(np.stack([columns, rows], axis=-1), depth)
        # the bird's-eye camera's picture has its own left: a line through the middle of its mask
        above = camera((0, 0, TOP + 5))
        xy, _ = above.project(points)
        return np.where(xy[..., 0] < W / 2, factor * depth, depth).astype(np.float32)

    assert share(two, mask, depths=[hidden(two[0]), top_depth(two[1])]) == pytest.approx(
        0.5, abs=0.07
    )
    half = [*(hidden(c) for c in four[:3]), top_depth(four[3])]
    assert share(four, mask, depths=half) == pytest.approx(0.5, abs=0.07)
    enough = [*(hidden(c) for c in four[:2]), *(top_depth(c) for c in four[2:])]
    assert share(four, mask, depths=enough) == 1.0
    # a depth that is a little short is rounding, and one that is longer is no occluder
    assert share(two, mask, depths=[hidden(c, 0.985) for c in two]) == 1.0
    assert share(two, mask, depths=[hidden(c, 1.5) for c in two]) == 1.0


def test_a_camera_that_sees_nothing_there_has_not_seen_it() -> None:
    nothing = [np.zeros((H, W), np.float32)] * 4
    assert share(around(60), middle(), depths=nothing) == 0.0


def test_what_is_off_the_picture_has_not_been_seen() -> None:
    aside = [camera((6, y, TOP + 5), (6, y, TOP)) for y in (0.0, 0.2)]
    assert share(aside, middle()) == 0.0
    # these two see the right half of the picture of the bird's-eye view, and no more
    above = camera((0, 0, TOP + 5))
    edge = above.unproject((W / 2, H / 2), 5.0)
    across = above.unproject((W, H / 2), 5.0) - edge
    halves = [
        Camera(K, look_at(edge + across + (0, 0, 5.0), edge + across, UP), W, H) for _ in range(2)
    ]
    assert share(halves, middle()) == pytest.approx(0.5, abs=0.1)


def test_an_empty_mask_or_one_over_nothing_has_no_share() -> None:
    assert share(around(60), np.zeros((H, W), np.bool_)) == 0.0
    assert share(around(60), middle(), bev_depth=np.zeros((H, W), np.float32)) == 0.0


def test_only_points_with_depth_count() -> None:
    depth = top_depth(camera((0, 0, TOP + 5)))
    depth[:, : W // 2] = 0
    assert share(around(60), middle(), bev_depth=depth) == 1.0
