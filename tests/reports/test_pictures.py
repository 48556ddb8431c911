from __future__ import annotations

import io

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from record_samples import png
from scipy import ndimage

from gvr_core.errors import InputError
from reports.pictures import OUTLINE, contact_sheet, query_picture

GREY = 0.5


def decoded(content: bytes) -> NDArray[np.uint8]:
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))


@pytest.fixture
def scene() -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """A grey picture (240, 400) with a red square, and a truth that is moved against it."""
    image = np.full((240, 400, 3), GREY, dtype=np.float32)
    image[80:160, 120:200] = (1.0, 0.0, 0.0)
    truth = np.zeros((240, 400), dtype=np.bool_)
    truth[90:170, 130:210] = True
    return image, truth


def test_the_truth_is_outlined_from_outside(
    scene: tuple[NDArray[np.float32], NDArray[np.bool_]],
) -> None:
    image, truth = scene
    plain, drawn = decoded(query_picture(image)), decoded(query_picture(image, truth))
    assert np.array_equal(drawn[truth], plain[truth])
    line = (drawn == OUTLINE).all(axis=2)
    assert line.any()
    # One closed ring: the truth cannot be left without crossing the line.
    outside, count = ndimage.label(~line)
    assert count == 2
    assert outside[130, 170] != outside[0, 0]
    changed = (drawn != plain).any(axis=2)
    assert ndimage.distance_transform_edt(~truth)[changed].max() <= 6


def test_without_truth_or_caption_the_picture_is_the_image(
    scene: tuple[NDArray[np.float32], NDArray[np.bool_]],
) -> None:
    image, truth = scene
    expected = np.rint(image * 255).astype(np.uint8)
    assert np.array_equal(decoded(query_picture(image)), expected)
    assert np.array_equal(decoded(query_picture(expected)), expected)
    assert np.array_equal(decoded(query_picture(image, np.zeros_like(truth))), expected)
    assert (decoded(query_picture(image, np.ones_like(truth))) == expected).all()


def test_the_caption_stands_below_in_bold_and_plain(
    scene: tuple[NDArray[np.float32], NDArray[np.bool_]],
) -> None:
    image, _ = scene

    def ink(caption: str) -> float:
        strip = decoded(query_picture(image, caption=caption))[240:]
        return float((strip < 128).all(axis=2).sum())

    one, two = (decoded(query_picture(image, caption=c)) for c in ("a cup", "a cup\nIoU 71"))
    assert 240 < one.shape[0] < two.shape[0]
    assert np.array_equal(one[:240], two[:240])
    assert ink("a cup") > 0
    # The first line is set in bold: the same words below it take less ink.
    assert ink("a cup\na cup") - ink("a cup") < ink("a cup")


@pytest.mark.parametrize("text", ["W" * 400, "m " * 300, "i" * 400, "two words " * 40])
def test_a_long_query_keeps_off_the_edges(
    text: str, scene: tuple[NDArray[np.float32], NDArray[np.bool_]]
) -> None:
    image, _ = scene
    strip = decoded(query_picture(image, caption=text))[240:]
    assert (strip[:, -4:] == 255).all() and (strip[:, :4] == 255).all()
    assert (strip[-3:] == 255).all()
    assert (strip < 128).any()
    assert strip.shape[0] < 120


def test_small_images_grow_by_whole_numbers() -> None:
    small = np.arange(24 * 50 * 3, dtype=np.uint8).reshape(24, 50, 3)
    grown = decoded(query_picture(small))
    assert grown.shape == (24 * 7, 50 * 7, 3)
    assert np.array_equal(grown[::7, ::7], small)


def test_floats_beyond_the_range_are_clipped() -> None:
    image = np.full((240, 320, 3), -0.5)
    image[:, 160:] = 1.5
    picture = decoded(query_picture(image))
    assert (picture[:, :160] == 0).all() and (picture[:, 160:] == 255).all()


def test_the_same_input_gives_the_same_bytes(
    scene: tuple[NDArray[np.float32], NDArray[np.bool_]],
) -> None:
    assert query_picture(*scene, "a cup\nIoU 71") == query_picture(*scene, "a cup\nIoU 71")


@pytest.mark.parametrize(
    ("image", "truth", "message"),
    [
        (np.zeros((4, 4)), None, r"shape \(4, 4\)"),
        (np.zeros((4, 4, 4)), None, r"shape \(4, 4, 4\)"),
        (np.zeros((0, 4, 3)), None, r"shape \(0, 4, 3\)"),
        (np.zeros((4, 4, 3), dtype=np.int64), None, "int64"),
        (np.full((4, 4, 3), np.nan), None, "NaN"),
        (np.zeros((4, 4, 3)), np.zeros((4, 5), dtype=np.bool_), r"truth .*\(4, 5\)"),
        (np.zeros((4, 4, 3)), np.zeros((4, 4), dtype=np.uint8), "truth .*uint8"),
    ],
)
def test_wrong_arrays_are_refused(image: np.ndarray, truth: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        query_picture(image, truth)


def test_the_sheet_is_a_grid_in_reading_order() -> None:
    colours = [(200, 0, 0), (0, 200, 0), (0, 0, 200), (90, 90, 0)]
    sheet = decoded(contact_sheet([png(c, (80, 60)) for c in colours], columns=3, width=632))
    cell = (632 - 4 * 8) // 3
    assert sheet.shape == (8 + 2 * (cell * 60 // 80 + 8), 632, 3)
    for i, colour in enumerate(colours):
        row, column = divmod(i, 3)
        y, x = 8 + row * (150 + 8) + 75, 8 + column * (cell + 8) + cell // 2
        assert tuple(sheet[y, x]) == colour
    assert (sheet[-75, -cell:] == 255).all()


def test_pictures_of_other_shapes_do_not_overlap() -> None:
    tall, wide = png((200, 0, 0), (50, 100)), png((0, 200, 0), (100, 50))
    sheet = decoded(contact_sheet([tall, wide, wide], columns=2, width=224))
    assert sheet.shape == (8 + 200 + 8 + 50 + 8, 224, 3)
    assert (sheet == (200, 0, 0)).all(axis=2).sum() == 100 * 200
    assert (sheet == (0, 200, 0)).all(axis=2).sum() == 2 * 100 * 50


@pytest.mark.parametrize(
    ("pictures", "columns", "message"),
    [
        ([], 3, "no pictures"),
        ([png((1, 2, 3)), b"no picture"], 3, r"pictures\[1\]"),
        ([png((1, 2, 3))], 0, "0 columns"),
        ([png((1, 2, 3))] * 99, 99, "99 columns"),
    ],
)
def test_wrong_sheets_are_refused(pictures: list[bytes], columns: int, message: str) -> None:
    with pytest.raises(InputError, match=message):
        contact_sheet(pictures, columns)
