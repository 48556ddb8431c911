from __future__ import annotations

import numpy as np
import pytest

from datasets.surfaces import box, crop_to_aspect, rectangle
from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.gaussians import SH_C0
from gvr_core.rendering.base import get_renderer


def checks(size: int = 64) -> np.ndarray:
    rows, columns = np.mgrid[0:size, 0:size]
    texture = np.zeros((size, size, 3), np.uint8)
    texture[..., 0] = np.where((rows // 16 + columns // 16) % 2, 230, 20)
    texture[..., 1] = 255 * columns // size
    texture[..., 2] = 255 * rows // size
    return texture


def test_a_rectangle_seen_head_on_looks_like_its_texture() -> None:
    texture = checks()
    surface = rectangle((-1, 0, 1), (2, 0, 0), (0, 0, -2), texture, 2 / 64)
    assert len(surface) == 64 * 64
    # at distance 2 with f = 64 px, 2 units cover 64 px
    eye = Camera(
        intrinsics(2 * np.degrees(np.arctan(0.5)), 64, 64),
        look_at((0, -2, 0), (0, 0, 0), (0, 0, 1)),
        64,
        64,
    )
    picture = get_renderer("numba").render(surface, eye)
    assert picture.alpha[4:-4, 4:-4].min() > 0.97
    inner = np.abs(picture.rgb - texture / 255)[2:-2, 2:-2]
    assert np.median(inner) < 0.03 and inner.mean() < 0.06
    np.testing.assert_allclose(picture.median_depth[8:-8, 8:-8], 2, atol=0.01)


def test_a_texture_is_not_mirrored_from_the_front() -> None:
    surface = rectangle((-1, 0, 1), (2, 0, 0), (0, 0, -2), checks(), 0.25)
    green = surface.sh[:, 0, 1]
    blue = surface.sh[:, 0, 2]
    assert np.corrcoef(green, surface.means[:, 0])[0, 1] > 0.95  # to the right
    assert np.corrcoef(blue, surface.means[:, 2])[0, 1] < -0.95  # downwards


def test_a_box_has_its_size_and_stands_on_the_ground() -> None:
    made = box((1.0, 0.5, 0.8), checks(), None, 0.02)
    np.testing.assert_allclose(made.means.min(axis=0), (-0.5, -0.25, 0.01), atol=0.011)
    np.testing.assert_allclose(made.means.max(axis=0), (0.5, 0.25, 0.8), atol=1e-6)
    faces = 2 * 50 * 40 + 2 * 25 * 40 + 50 * 25
    assert len(made) == faces
    assert made.scales.min(axis=1).max() < 0.1 * made.scales.max(axis=1).min()


def test_a_card_shows_its_rim_at_the_sides() -> None:
    rim = np.full((4, 4, 3), 200, np.uint8)
    made = box((1.0, 0.02, 0.8), checks(), rim, 0.02)
    side = np.abs(made.means[:, 0]) == np.float32(0.5)
    colours = 0.5 + SH_C0 * made.sh[side, 0]
    assert side.sum() > 50
    assert np.ptp(colours, axis=1).max() < 0.01 and 0.5 < colours.mean() < 0.8


@pytest.mark.parametrize(
    "aspect, shape",
    [(1.0, (30, 30)), (2.0, (30, 60)), (4.0, (15, 60)), (0.1, (30, 3)), (1000.0, (1, 60))],
)
def test_crops_keep_the_middle(aspect: float, shape: tuple[int, int]) -> None:
    picture = np.zeros((30, 60, 3), np.uint8)
    picture[14:16, 29:31] = 255
    cut = crop_to_aspect(picture, aspect)
    assert cut.shape[:2] == shape
    assert cut.max() == 255
