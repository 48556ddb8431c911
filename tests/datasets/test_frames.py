"""Frames are matched by name, by index where that is the rule, and never by both at odds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from datasets.capture import CaptureImage
from datasets.frames import match_frame
from gvr_core.cameras import Camera
from gvr_core.errors import DatasetError

CAMERA = Camera(np.diag([10.0, 10, 1]), np.eye(4), 8, 6)
PLACE = Path("label", "frame.json")


def images(*names: str) -> list[CaptureImage]:
    return [CaptureImage(name, CAMERA, None) for name in names]


LERF = images(*(f"frame_{i:05d}.jpg" for i in range(1, 6)))
PHONE = images("IMG_2031.jpg", "IMG_2040.jpg", "IMG_2044.jpg")


@pytest.mark.parametrize(
    ("given", "stem", "index", "name"),
    [
        (LERF, "frame_00003", None, "frame_00003.jpg"),
        (LERF, "frame_00003", 2, "frame_00003.jpg"),
        (LERF[::-1], "frame_00003", 2, "frame_00003.jpg"),  # the order given does not count
        (PHONE, "00", 0, "IMG_2031.jpg"),
        (PHONE, "02", 2, "IMG_2044.jpg"),
        (images("0001.png", "0002.png"), "01", None, "0001.png"),
        (images("00.png", "01.png"), "1", 1, "01.png"),
        (images("1.png", "01.png"), "01", None, "01.png"),  # letter for letter goes first
        (images("left/a.png", "right/a.png"), "right/a", None, "right/a.png"),
        (images("left/a.png", "left/b.png"), "b", None, "left/b.png"),
        (images("a.b.png", "a.png"), "a.b", None, "a.b.png"),
    ],
)
def test_matched(given: list[CaptureImage], stem: str, index: int | None, name: str):
    assert match_frame(given, stem, index).name == name


@pytest.mark.parametrize(
    ("given", "stem", "index", "message"),
    [
        (LERF, "frame_00003", 3, r"'frame_00003.jpg' by its name, but its index 3 is 'frame_00004"),
        (LERF, "frame_00005", 5, r"'frame_00005.jpg' by its name, but .* beyond the 5 pictures"),
        (LERF, "frame_00003", -3, r"its index -3 is beyond the 5 pictures"),
        (LERF, "frame_00009", None, r"'frame_00009' is not among the 5 registered"),
        # Numbered like the pictures: an index would lead to a neighbour.
        (LERF, "frame_00009", 2, r"'frame_00009' is not among the 5 registered"),
        (images("00.png", "02.png"), "01", 1, r"'01' is not among the 2 registered"),
        (PHONE, "03", 3, r"'03' has the index 3.*0 to 2"),
        (PHONE, "00", None, r"'00' is not among the 3 registered.*IMG_2031"),
        (images("left/a.png", "right/a.png"), "a", None, r"may be left/a.png, right/a.png"),
        (images("a.png", "a.jpg"), "a", None, r"may be a.jpg, a.png"),
        (images("1.png", "01.png"), "001", None, r"may be 01.png, 1.png"),
        (images(), "a", 0, r"of which there is none"),
    ],
)
def test_refused(given: list[CaptureImage], stem: str, index: int | None, message: str):
    with pytest.raises(DatasetError, match=message) as caught:
        match_frame(given, stem, index, path=PLACE, place="info.name")
    assert caught.value.path == str(PLACE)
    assert caught.value.place == "info.name"
    assert caught.value.accepted


def test_pictures_without_a_camera_count_for_the_index():
    registered = images("IMG_1.jpg", "IMG_3.jpg")
    assert match_frame(registered, "02", 2, unregistered=["IMG_2.jpg"]).name == "IMG_3.jpg"
    with pytest.raises(DatasetError, match=r"'01' is the picture 'IMG_2.jpg', which has no camera"):
        match_frame(registered, "01", 1, unregistered=["IMG_2.jpg"])
    with pytest.raises(DatasetError, match=r"'IMG_2' is the picture .* no camera"):
        match_frame(registered, "IMG_2", unregistered=["IMG_2.jpg"])


def test_without_that_the_index_would_be_another_picture():
    """The case that the refusal of disagreement is for: one picture of five is not registered."""
    registered = [image for image in LERF if image.name != "frame_00002.jpg"]
    with pytest.raises(DatasetError, match=r"'frame_00004.jpg' by its name.*'frame_00005.jpg'"):
        match_frame(registered, "frame_00004", 3)
    found = match_frame(registered, "frame_00004", 3, unregistered=["frame_00002.jpg"])
    assert found.name == "frame_00004.jpg"
