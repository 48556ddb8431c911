"""Spoilt camera files: refused with an error of ours, or read into cameras that can be used."""

from __future__ import annotations

import json

import pytest
from hostile_inputs import NUMBERS, TEXTS, damaged, misled, quickly, read, seeds
from hypothesis import given
from hypothesis import strategies as st

COLMAP = [f"colmap-{p}-{k}" for p in ("cameras", "images", "points3D") for k in ("bin", "txt")]
JSON = ["cameras-json", "transforms-json"]


@pytest.mark.parametrize("name", COLMAP + JSON)
@quickly
@given(data=st.data())
def test_damaged_files(name: str, data: st.DataObject) -> None:
    read(name, data.draw(damaged(name)))


@pytest.mark.parametrize("name", JSON)
@quickly
@given(data=st.data())
def test_values_of_other_kinds(name: str, data: st.DataObject) -> None:
    read(name, data.draw(misled(name)))


@quickly
@given(st.lists(NUMBERS, min_size=16, max_size=16), NUMBERS, NUMBERS, NUMBERS)
def test_numbers_at_the_ends_of_their_range(
    pose: list[float], focal: float, width: float, scale: float
) -> None:
    matrix = [pose[i : i + 4] for i in range(0, 16, 4)]
    frame = {"file_path": "a.png", "transform_matrix": matrix, "fl_x": focal, "w": width, "h": 9}
    read("transforms-json", json.dumps({"frames": [frame], "applied_scale": scale}).encode())
    camera = {
        "img_name": "a", "width": width, "height": 9, "position": pose[:3], "fx": focal, "fy": 1.0,
        "rotation": [pose[3:6], pose[6:9], pose[9:12]],
    }  # fmt: skip
    read("cameras-json", json.dumps([camera]).encode())
    words = " ".join(str(number) for number in pose[:7])
    read("colmap-images-txt", f"1 {words} 1 a.png\n\n".encode())
    read("colmap-cameras-txt", f"1 PINHOLE {width} 9 {focal} 1 2 3\n".encode())


@quickly
@given(TEXTS)
def test_names_of_images(name: str) -> None:
    (content,) = seeds("cameras-json")
    cameras = json.loads(content)
    cameras[0]["img_name"] = name
    if read("cameras-json", json.dumps(cameras).encode()):
        assert ".." not in name.split("/")
        assert not name.startswith("/")
        assert name.isprintable()


def test_what_is_spoilt_was_good() -> None:
    for name in COLMAP + JSON:
        assert all(read(name, seed) for seed in seeds(name))
