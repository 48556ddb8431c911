"""Square crops of patches."""

from __future__ import annotations

import numpy as np
import pytest

from gvr_core.errors import ModelError
from gvr_core.models.base import Mask
from gvr_core.models.crops import GREY, crop_patch, crop_patches, to_uint8

RED, BLUE = np.array([255, 0, 0], np.uint8), np.array([0, 0, 255], np.uint8)
FILL = np.full(3, GREY, np.uint8)


def scene() -> tuple[np.ndarray, Mask]:
    """A red patch, 30 wide and 20 high, on blue."""
    picture = np.tile(BLUE, (100, 120, 1))
    pixels = np.zeros((100, 120), np.bool_)
    pixels[40:60, 50:80] = True
    pixels[40:45, 50:55] = False
    picture[pixels] = RED
    return picture, Mask(pixels)


def share(picture: np.ndarray, colour: np.ndarray) -> float:
    """Share of the pixels nearer to one colour than to any other of the three."""
    known = np.stack([colour, *(c for c in (RED, BLUE, FILL) if (c != colour).any())])
    distance = np.abs(picture[..., None, :].astype(int) - known).sum(axis=-1)
    return float(np.mean(distance.argmin(axis=-1) == 0))


def test_masked_shows_the_patch_alone() -> None:
    crop = crop_patch(*scene(), "masked", 300)
    assert crop.shape == (300, 300, 3) and crop.dtype == np.uint8
    assert share(crop, BLUE) == 0
    # 575 of the pixels of a square of side 30; the shorter side is padded with grey.
    assert share(crop, RED) == pytest.approx(575 / 30**2, abs=0.03)
    assert (crop[:20] == GREY).all() and (crop[-20:] == GREY).all()


def test_bbox_shows_what_the_box_holds_and_pads_the_rest() -> None:
    crop = crop_patch(*scene(), "bbox", 300)
    assert share(crop, RED) == pytest.approx(575 / 900, abs=0.03)
    assert share(crop, BLUE) == pytest.approx(25 / 900, abs=0.01)
    assert share(crop, FILL) == pytest.approx(1 / 3, abs=0.03)


def test_context_shows_half_as_much_again() -> None:
    crop = crop_patch(*scene(), "context", 300)
    side = 46  # 30 and 8 on each side
    assert share(crop, RED) == pytest.approx(575 / side**2, abs=0.03)
    assert share(crop, BLUE) > 0.3


def test_nothing_is_stretched() -> None:
    pixels = np.zeros((100, 120), np.bool_)
    pixels[10:20, 20:100] = True
    crop = crop_patch(np.tile(RED, (100, 120, 1)), Mask(pixels), "bbox", 160)
    rows = np.flatnonzero((crop == RED).all(axis=-1).any(axis=1))
    assert len(rows) == pytest.approx(20, abs=3)


def test_a_patch_at_the_edge_keeps_its_place_in_the_square() -> None:
    pixels = np.zeros((50, 50), np.bool_)
    pixels[:10, :10] = True
    crop = crop_patch(np.tile(RED, (50, 50, 1)), Mask(pixels), "context", 64)
    assert share(crop, RED) == 1.0


def test_an_empty_mask_is_grey() -> None:
    picture, _ = scene()
    for mode in ("masked", "bbox", "context"):
        assert (crop_patch(picture, Mask(np.zeros((100, 120), np.bool_)), mode, 32) == GREY).all()


def test_crops_of_a_frame_come_in_order_and_fit_it() -> None:
    picture, mask = scene()
    rgb = picture.astype(np.float32) / 255
    crops = crop_patches(rgb, [mask, Mask(~mask.pixels)], "masked", 40)
    assert crops.shape == (2, 40, 40, 3)
    assert np.array_equal(crops[0], crop_patch(picture, mask, "masked", 40))
    assert crop_patches(rgb, [], "masked", 40).shape == (0, 40, 40, 3)
    with pytest.raises(ModelError, match=r"mask 1 has shape \(3, 3\).*\(100, 120\)"):
        crop_patches(rgb, [mask, Mask(np.ones((3, 3), np.bool_))], "masked", 40)


def test_colours_are_clipped_and_rounded() -> None:
    values = np.array([[-0.5, 0.0, 0.5 / 255, 0.6 / 255, 1.0, 7.0]], np.float32)
    assert to_uint8(values).tolist() == [[0, 0, 0, 1, 255, 255]]
