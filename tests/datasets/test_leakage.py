"""Test views can be kept out of what a method may look at."""

from __future__ import annotations

from dataclasses import replace

import pytest
from small_scene import OBJECTS, two_boxes

from datasets.base import GroundTruth, SceneData
from datasets.leakage import without_test_views
from gvr_core.errors import DatasetError

DIGESTS = dict.fromkeys(("gaussians", "views", "queries", "truth"), "0" * 64)


def scene(tested: slice) -> SceneData:
    """A scene whose test views are among its knowledge views, as in LERF-OVS."""
    made, labels = two_boxes()
    truth = GroundTruth(OBJECTS, made.views[tested], {}, labels)
    return SceneData(made, (), truth, DIGESTS)


def test_test_views_go_and_the_digest_and_a_note_say_so() -> None:
    data = scene(slice(0, 2))
    without = without_test_views(data)
    names = [view.name for view in data.scene.views]
    assert [view.name for view in without.scene.views] == names[2:]
    assert without.truth is data.truth
    changed = {part for part in DIGESTS if without.digests[part] != data.digests[part]}
    assert changed == {"views"}
    assert without.notes == ("2 test views are kept out of the books",)
    other = without_test_views(scene(slice(1, 3)))
    assert other.digests["views"] != without.digests["views"]


def test_a_scene_that_holds_them_out_stays_as_it_is() -> None:
    data = scene(slice(0, 2))
    apart = replace(data, scene=replace(data.scene, views=data.scene.views[2:]))
    assert without_test_views(apart) is apart


def test_no_view_left_is_refused() -> None:
    with pytest.raises(DatasetError, match=r"all \d+ views are test views"):
        without_test_views(scene(slice(None)))
