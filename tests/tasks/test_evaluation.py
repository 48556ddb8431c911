"""Scoring a scene: which pairs count, what is left out and counted, what competes for pixels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from small_scene import OBJECTS, two_boxes

from datasets.base import GroundTruth, SceneData
from datasets.polygons import PolygonMask
from gvr_core.errors import DatasetError
from gvr_core.rendering import get_renderer
from gvr_core.scene import Query
from tasks.evaluation import score_scene
from tasks.groundings import Answer

RENDERER = get_renderer("numba")
RED, BLUE = OBJECTS[:2]
QUERIES = (
    Query(id="red", text="red", target=RED),
    Query(id="red-again", text="crimson", target=RED),
    Query(id="blue", text="blue", target=BLUE),
    Query(id="unknown", text="what nobody knows"),
)


def square(x0: int, y0: int, x1: int, y1: int, size: tuple[int, int]) -> PolygonMask:
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], float)
    return PolygonMask((corners,), size)


@pytest.fixture(scope="module")
def data() -> SceneData:
    """Two test views; blue is labelled in the first alone, and there it is hidden."""
    scene, labels = two_boxes()
    views = scene.views[:2]
    size = (views[0].camera.width, views[0].camera.height)
    masks = {
        (views[0].name, RED): square(10, 10, 30, 30, size),
        (views[1].name, RED): square(5, 5, 20, 20, size),
        (views[0].name, BLUE): PolygonMask((), size),
    }
    boxes = {(views[0].name, RED): ((10.0, 10.0, 30.0, 30.0),)}
    truth = GroundTruth(OBJECTS, views, masks, labels, boxes)
    digests = dict.fromkeys(("gaussians", "views", "queries", "truth"), "0" * 64)
    return SceneData(scene, QUERIES, truth, digests)


def pictures(data: SceneData, **views: NDArray[np.generic]) -> Answer:
    n = len(data.scene.gaussians)
    return Answer(np.zeros(n, np.bool_), np.zeros(n, np.float32), None, True, 1.0, views)


def blank(data: SceneData) -> NDArray[np.uint8]:
    camera = data.truth.test_views[0].camera
    return np.zeros((camera.height, camera.width), np.uint8)


def scores(data: SceneData, answers: list[Answer], *protocols: str):
    return score_scene(data, QUERIES, answers, RENDERER, protocols)


def test_only_labelled_pairs_count_and_empty_ones_are_left_out(data: SceneData) -> None:
    one, two = (view.name for view in data.truth.test_views)
    right = (data.truth.mask(data.truth.test_views[0], RED) * 255).astype(np.uint8)
    red = pictures(data, **{one: right, two: blank(data)})
    nothing = pictures(data, **{one: blank(data), two: blank(data)})
    scored = scores(data, [red, nothing, nothing, nothing], "lerf_ovs.langsplat_2d/1")
    found = {(row["query"], row["view"]): row["metrics"]["iou"] for row in scored.rows}
    assert found == {
        ("red", one): 1.0,
        ("red", two): 0.0,
        ("red-again", one): 0.0,
        ("red-again", two): 0.0,
    }
    # Blue is not labelled in the second view; in the first, truth and prediction are empty.
    assert (scored.unlabelled, scored.left_out) == (1, 1)


def test_something_where_nothing_is_labelled_scores_zero(data: SceneData) -> None:
    one = data.truth.test_views[0].name
    blue = pictures(data, **{one: blank(data) + np.uint8(255)})
    rows = scores(data, [blue] * 4, "ovs3d.binary/1").rows
    assert [row["metrics"]["iou"] for row in rows if row["query"] == "blue"] == [0.0]


def test_a_missing_prediction_is_nothing_or_is_skipped_as_the_protocol_says(
    data: SceneData,
) -> None:
    one = data.truth.test_views[0].name
    only_one = pictures(data, **{one: blank(data)})
    scored = scores(data, [only_one] * 4, "lerf_mask.gg/1", "lerf_mask.gg_compat/1")
    red = [row for row in scored.rows if row["query"] == "red"]
    metrics = {(row["protocol"], row["view"] == one): row["metrics"] for row in red}
    assert metrics["lerf_mask.gg/1", False]["iou"] == 0
    assert metrics["lerf_mask.gg_compat/1", True]["iou"] == 0
    assert metrics["lerf_mask.gg_compat/1", False] == {"skipped": 1.0}, "expected, and skipped"


def test_prompts_that_compete_take_part_once_an_object(data: SceneData) -> None:
    one = data.truth.test_views[0].name
    red = pictures(data, **{one: blank(data) + np.uint8(200)})
    blue = pictures(data, **{one: blank(data) + np.uint8(90)})
    rows = scores(data, [red, red, blue, red], "ovs3d.exclusive/1").rows
    here = {row["query"] for row in rows if row["view"] == one}
    assert "red" in here and "red-again" not in here


def test_a_missing_class_claims_nothing(data: SceneData) -> None:
    """Else the class that sorts first would get every pixel that no other class claims."""
    one = data.truth.test_views[0].name
    nothing = pictures(data)
    red = pictures(data, **{one: (data.truth.mask(data.truth.test_views[0], RED) * 255)})
    rows = scores(data, [red, red, nothing, red], "ovs3d.exclusive/1").rows
    found = {row["query"]: row["metrics"]["iou"] for row in rows if row["view"] == one}
    assert found["blue"] == 0
    rows = scores(data, [nothing] * 4, "ovs3d.exclusive/1").rows
    assert all(row["metrics"]["iou"] == 0 for row in rows)


def test_a_part_of_the_queries_is_no_contest(data: SceneData) -> None:
    one = data.truth.test_views[0].name
    red = pictures(data, **{one: blank(data) + np.uint8(200)})
    assert not score_scene(data, QUERIES[:1], [red], RENDERER, ["ovs3d.exclusive/1"]).rows


def test_what_a_protocol_gives_no_number_for_was_expected(data: SceneData) -> None:
    one = data.truth.test_views[0].name
    maps = pictures(data, **{one: blank(data)[None].astype(np.float32)})
    rows = scores(data, [maps] * 4, "lerf_ovs.opengaussian_3d/1").rows
    assert [r["metrics"] for r in rows if r["query"] == "red" and r["view"] == one] == [
        {"skipped": 1.0}
    ]


def test_pictures_of_other_views_are_refused(data: SceneData) -> None:
    strange = pictures(data, elsewhere=blank(data))
    with pytest.raises(DatasetError, match="predictions for elsewhere"):
        scores(data, [strange] * 4, "ovs3d.binary/1")


def test_flags_are_drawn_and_compared_in_3d(data: SceneData) -> None:
    flags = data.truth.flags(RED)
    assert flags is not None
    answer = Answer(flags, flags.astype(np.float32), None, True, 1.0)
    scored = scores(data, [answer] * 4, "flags_3d/1", "refusal/1", "lerf_ovs.opengaussian_3d/1")
    by_protocol: dict[str, list[str]] = {}
    for row in scored.rows:
        by_protocol.setdefault(row["protocol"], []).append(row["query"])
    assert by_protocol["flags_3d/1"] == ["red", "red-again", "blue"]
    assert by_protocol["refusal/1"] == ["red", "red-again", "blue"]
    assert "unknown" not in by_protocol["lerf_ovs.opengaussian_3d/1"]


def test_a_picture_of_another_size_is_refused(data: SceneData) -> None:
    one = data.truth.test_views[0].name
    small = pictures(data, **{one: np.zeros((4, 5), np.uint8)})
    with pytest.raises(DatasetError, match="5 x 4 pixels"):
        scores(data, [small] * 4, "ovs3d.binary/1")


def test_relevancy_maps_reach_the_protocol_as_they_are(data: SceneData) -> None:
    view = data.truth.test_views[0]
    peak = blank(data).astype(np.float32)
    peak[20, 20] = 0.9
    maps = np.stack([peak, peak * 0.1, peak * 0])
    rows = scores(data, [pictures(data, **{view.name: maps})] * 4, "lerf_ovs.langsplat_2d/1").rows
    (first,) = [r for r in rows if r["query"] == "red" and r["view"] == view.name]
    assert first["metrics"]["acc"] == 1.0


def test_given_pictures_survive_the_store(data: SceneData, tmp_path: Path) -> None:
    from gvr_core.methods.base import nothing_found
    from tasks.groundings import pack_groundings, unpack_answers
    from tasks.store import Store

    rng = np.random.default_rng(0)
    nothing = nothing_found(data.scene)
    grey = rng.integers(0, 255, (7, 9)).astype(np.uint8)
    maps = rng.random((3, 7, 9)).astype(np.float32)
    given = [replace(nothing, given={"a": grey, "b/c": maps}), nothing, replace(nothing, given={})]
    store = Store(tmp_path)
    arrays = pack_groundings(given, len(data.scene.gaussians))
    back = unpack_answers(store.load_arrays(store.put_arrays("groundings", arrays)))
    assert back[1].given is None and back[2].given == {}
    assert back[0].given is not None
    np.testing.assert_array_equal(back[0].given["a"], grey)
    np.testing.assert_array_equal(back[0].given["b/c"], maps)
