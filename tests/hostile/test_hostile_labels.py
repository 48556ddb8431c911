"""Spoilt labels, queries and lists of classes: refused with an error of ours, or read."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hostile_inputs import damaged, misled, quickly, read, seeds
from hypothesis import given, settings
from hypothesis import strategies as st

from datasets.polygons import PolygonMask

JSON = ["lerf-labels", "scene-json", "queries-json"]
OTHERS = ["classes", "labels-npy"]


@pytest.mark.parametrize("name", JSON + OTHERS)
@quickly
@given(data=st.data())
def test_damaged_files(name: str, data: st.DataObject) -> None:
    read(name, data.draw(damaged(name)))


@pytest.mark.parametrize("name", JSON)
@quickly
@given(data=st.data())
def test_values_of_other_kinds(name: str, data: st.DataObject) -> None:
    read(name, data.draw(misled(name)))


@pytest.mark.parametrize("name", JSON)
@pytest.mark.parametrize("depth", [65, 300, 700, 900, 950, 980, 995, 5000])
def test_values_that_are_nested_too_deeply(name: str, depth: int) -> None:
    # Some of these are parsed, and would break what prints them.
    (content,) = seeds(name)
    value = json.loads(content)
    holder = value[0] if isinstance(value, list) else value
    holder[next(iter(holder))] = "here"
    text = json.dumps(value).replace('"here"', "[" * depth + "]" * depth)
    assert not read(name, text.encode())


CORNERS = st.lists(
    st.tuples(st.integers(-20, 40), st.integers(-20, 40)) | st.sampled_from([(10**6, -(10**6))]),
    min_size=3,
    max_size=7,
)


@settings(quickly, max_examples=60)
@given(CORNERS, st.integers(1, 20), st.integers(1, 20))
def test_a_polygon_is_visible_if_it_is_drawn(
    corners: list[tuple[int, int]], width: int, height: int
) -> None:
    mask = PolygonMask((np.array(corners, np.float64),), (width, height))
    assert mask.is_visible() == mask.pixels().any()


def test_a_thousand_objects_of_a_huge_picture_are_told_quickly() -> None:
    # Drawn, each would take a canvas of 79 million pixels.
    thing = {"category": "a", "bbox": [0, 0, 9, 9]}
    around = [[-9, -9], [99_999, -9], [99_999, 99_999], [-9, 99_999]]
    objects = [thing | {"segmentation": [*around, [-9 - i, 5]]} for i in range(1000)]
    info = {"name": "frame_00001.jpg", "width": 8888, "height": 8888}
    assert read("lerf-labels", json.dumps({"info": info, "objects": objects}).encode())


def test_what_is_spoilt_was_good() -> None:
    for name in JSON + OTHERS:
        assert all(read(name, seed) for seed in seeds(name))
