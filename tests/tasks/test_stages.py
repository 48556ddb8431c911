"""Which stages a change computes again: those that depend on it, and no others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from native_scene import parts, written

from datasets.base import SceneData
from datasets.native import read_scene
from gvr_core.errors import StoreError
from gvr_core.methods import METHODS, MethodConfig, Toolbox, build_method
from gvr_core.methods.gvr_paper import LocateConfig, SegmentConfig
from gvr_core.methods.lift import LiftConfig
from gvr_core.models.base import Models
from gvr_core.models.oracle import OracleWorld, oracle_models
from gvr_core.models.random_encoder import RandomEncoder
from gvr_core.rendering import get_renderer
from gvr_core.robust.calibration import CALIBRATED, Calibration
from gvr_core.robust.config import RobustConfig, RobustIndex, RobustLocate
from tasks.computing import compute_depth
from tasks.groundings import unpack_answers
from tasks.scene_job import SceneJob
from tasks.stages import PREPARATION, STAGES, run_stages
from tasks.store import Store

NAMES = tuple(planned.stage.name for planned in STAGES)
FROM_INDEX = NAMES[NAMES.index("index") :]
FROM_QUERY = NAMES[NAMES.index("query") :]
FROM_SEGMENT = NAMES[NAMES.index("segment") :]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> SceneData:
    return read_scene(written(tmp_path_factory.mktemp("data") / "two-boxes", **parts(views=10)))


@pytest.fixture(scope="module")
def models(data: SceneData) -> Models:
    truth = data.truth
    assert truth.labels is not None
    meanings = {query.text: query.target for query in data.queries if query.target}
    digest = "ab" * 32
    world = OracleWorld(data.scene.gaussians, truth.labels, truth.objects, meanings, digest)
    return oracle_models(world)


@pytest.fixture
def job(data: SceneData, models: Models, tmp_path: Path) -> SceneJob:
    """gvr-robust on the two boxes, with a store of this test."""
    tools = Toolbox(get_renderer("numba"), models)
    method = MethodConfig(method="gvr-robust")
    return SceneJob(Store(tmp_path / "store"), data, data.queries, method, tools)


def keys(job: SceneJob) -> dict[str, str]:
    """The stages' keys; a stage's own key stands for the digest of what it computes."""
    known = job.digests()
    found: dict[str, str] = {}
    for planned in STAGES:
        inputs = {name: known[name] for name in planned.inputs}
        key = planned.stage.key(inputs, job.config())
        found[planned.stage.name] = known[planned.stage.name] = key
    return found


def touched(job: SceneJob, other: SceneJob) -> tuple[str, ...]:
    """The stages that have to be computed again."""
    before, after = keys(job), keys(other)
    return tuple(name for name in NAMES if before[name] != after[name])


def with_method(job: SceneJob, name: str = "gvr-robust", **parts: Any) -> SceneJob:
    return replace(job, method=MethodConfig.model_validate({"method": name, **parts}))


def another(value: Any) -> Any:
    """A different value that the same setting takes."""
    if isinstance(value, bool) or value is None:
        return not value
    return value + 1 if isinstance(value, int) else 0.37


def test_the_stages_are_these_and_come_after_what_they_read() -> None:
    assert NAMES == (
        "render",
        "depth",
        "masks",
        "encode",
        "index",
        "query",
        "segment",
        "evaluate",
    )
    assert NAMES[: len(PREPARATION)] == PREPARATION
    for i, planned in enumerate(STAGES):
        assert set(planned.inputs).isdisjoint(NAMES[i:])


@pytest.mark.parametrize("name", list(RobustConfig.model_fields))
def test_a_setting_of_gvr_robust_touches_its_step_and_what_follows(job, name) -> None:
    value = 0.6 if name == "refuse_below" else another(getattr(RobustConfig(), name))
    if name in RobustIndex.model_fields:
        expected = FROM_INDEX
    elif name in RobustLocate.model_fields:
        expected = FROM_QUERY
    else:
        expected = FROM_SEGMENT
    assert touched(job, with_method(job, robust={name: value})) == expected


@pytest.mark.parametrize("name", list(METHODS))
def test_settings_of_other_methods_touch_nothing(job, name) -> None:
    own = {
        "gvr-paper": {"locate", "segment"},
        "random-patch": {"locate", "segment"},
        "gvr-robust": {"robust"},
        "lift": {"lift"},
    }[name]
    foreign: dict[str, Any] = {
        "locate": LocateConfig(top_k=3, rfl=False),
        "segment": SegmentConfig(ring_views=9, smfi=False),
        "robust": RobustConfig(ground_up=False, gate=0.7, keep_at=0.6),
        "lift": LiftConfig(threshold=0.9, temperature=3.0),
    }
    plain = with_method(job, name)
    mixed = {part: value for part, value in foreign.items() if part not in own}
    assert touched(plain, with_method(job, name, **mixed, label="renamed")) == ()
    for part in own:
        assert "segment" in touched(plain, with_method(job, name, **{part: foreign[part]}))


def test_methods_share_the_books_and_nothing_after_them(job) -> None:
    every = {name: keys(with_method(job, name)) for name in METHODS}
    for stage in NAMES:
        shared = stage in ("render", "depth", "masks", "encode")
        assert len({found[stage] for found in every.values()}) == (1 if shared else len(METHODS))


def test_the_wording_of_queries_is_no_part_of_the_index(job) -> None:
    first, *rest = job.queries
    reworded = replace(job, queries=[first.model_copy(update={"text": "a ruby cube"}), *rest])
    assert touched(job, reworded) == FROM_QUERY
    # what the right answer is changes the scores alone
    known = replace(job, queries=[first.model_copy(update={"target": "blue box"}), *rest])
    assert touched(job, known) == ("evaluate",)


@pytest.mark.parametrize(
    ("part", "expected"),
    [("gaussians", NAMES), ("views", NAMES), ("truth", ("evaluate",))],
)
def test_parts_of_the_scene_touch_what_reads_them(job, part, expected) -> None:
    data = replace(job.data, digests={**job.data.digests, part: "cd" * 32})
    assert touched(job, replace(job, data=data)) == expected


def test_models_and_renderer_touch_what_uses_them(job) -> None:
    def using(**models: Any) -> SceneJob:
        return replace(job, tools=replace(job.tools, models=replace(job.tools.models, **models)))

    assert touched(job, using(encoder=RandomEncoder(0))) == NAMES[NAMES.index("encode") :]
    named = replace(job.tools.models.text_segmenter.world, digest="ef" * 32)  # type: ignore
    others = oracle_models(named)
    assert touched(job, using(text_segmenter=others.text_segmenter)) == FROM_SEGMENT
    assert touched(job, using(segmenter=others.segmenter)) == NAMES[NAMES.index("masks") :]
    drawn = replace(job, tools=replace(job.tools, renderer=get_renderer("torch-reference")))
    assert touched(job, drawn) == NAMES


def test_another_calibration_touches_the_query_and_what_follows(job, monkeypatch) -> None:
    before = keys(job)
    monkeypatch.setitem(CALIBRATED, "oracle", Calibration(phrases=False, refuse_below=0.7))
    after = keys(job)
    assert tuple(name for name in NAMES if before[name] != after[name]) == FROM_QUERY


@pytest.mark.parametrize("name", ["gvr-paper", "gvr-robust"])
def test_the_colour_behind_virtual_views_is_part_of_segmenting(job, name) -> None:
    """A scene that fills all its views looks the same on any background: the key must say it."""
    plain = with_method(job, name)
    white = with_method(job, name, segment={"background": (1.0, 1.0, 1.0)})
    stage = next(planned for planned in STAGES if planned.stage.name == "segment").stage
    same = dict.fromkeys(("gaussians", "render", "query"), "ab" * 32)
    assert stage.key(same, plain.config()) != stage.key(same, white.config())
    assert touched(plain, white)[0] == "render"


def states(job: SceneJob) -> dict[str, bool]:
    """Stage -> whether it had to be computed, in a real run."""
    return {name: not run.cached for name, run in run_stages(job).items()}


def test_runs_compute_what_the_keys_say(job) -> None:
    assert all(states(job).values())
    assert not any(states(job).values())
    voting = with_method(job, robust={"soft_vote": False})
    assert [name for name, computed in states(voting).items() if computed] == list(FROM_SEGMENT)
    plain = with_method(job, robust={"canonical_negatives": False})
    computed = [name for name, computed in states(plain).items() if computed]
    # the places are the same to the last digit, or all that follows is made anew
    assert computed[0] == "query" and "index" not in computed
    upright = with_method(job, robust={"ground_up": False})
    assert next(name for name, computed in states(upright).items() if computed) == "index"
    paper = with_method(job, "gvr-paper")
    assert [name for name, computed in states(paper).items() if computed] == list(FROM_INDEX)
    assert not any(states(with_method(job, "gvr-paper", robust={"gate": 0.9})).values())
    assert not any(states(job).values())


@pytest.mark.parametrize("name", ["gvr-paper", "gvr-robust", "lift"])
def test_an_index_is_stored_as_the_method_made_it(job, name) -> None:
    job = with_method(job, name)
    runs = run_stages(job)
    stored = job.store.load_arrays(runs["index"]["index"])
    names = {
        "gvr-paper": set(),
        "gvr-robust": {"up", "steady"},
        "lift": {"weights", "patches", "row_ptr", "lengths"},
    }[name]
    assert set(stored) == names == set(runs["index"].record.detail["arrays"])  # type: ignore
    answers = unpack_answers(job.store.load_arrays(runs["segment"]["groundings"]))
    found = {query.id: answer for query, answer in zip(job.queries, answers, strict=True)}
    labels = job.data.truth.labels
    assert labels is not None
    for query in job.queries:
        answer = found[query.id]
        assert answer.found is not query.absent and answer.flags.any() == answer.found
        if query.target is not None:
            truth = labels == job.data.truth.objects.index(query.target)
            assert truth[answer.flags].mean() > 0.8


def test_stages_apart_answer_as_the_method_at_one_go(job) -> None:
    runs = run_stages(job)
    answers = unpack_answers(job.store.load_arrays(runs["segment"]["groundings"]))
    method = build_method(job.method, job.tools)
    books = method.prepare(job.data.scene)
    for query, answer in zip(job.queries, answers, strict=True):
        whole = method.ground(job.data.scene, books, query)
        np.testing.assert_array_equal(answer.flags, whole.flags)
        np.testing.assert_array_equal(answer.scores, whole.scores)
        assert answer.confidence == whole.confidence


class CountingRenderer:
    """The real renderer, counting; a test double in that alone."""

    name = "counting"

    def __init__(self) -> None:
        self.renders = 0

    def render(self, *arguments: Any, **named: Any) -> Any:
        self.renders += 1
        return get_renderer("numba").render(*arguments, **named)


def test_each_view_is_drawn_once_for_both_books(job) -> None:
    renderer = CountingRenderer()
    counted = replace(job, tools=replace(job.tools, renderer=renderer))
    runs = run_stages(counted, last="encode")
    assert list(runs) == ["render", "depth", "masks", "encode"]
    assert renderer.renders == len(job.data.scene.views)
    assert runs["depth"]["depths"] == runs["render"]["depths"]
    features = job.store.load_arrays(runs["encode"]["features"])["features"]
    assert features.dtype == np.float16
    # the Depth Book has been lost: it is drawn again, and what was made from it stands
    job.store.path(runs["depth"]["depths"]).unlink()
    again = run_stages(counted, last="encode")
    assert [name for name, run in again.items() if not run.cached] == ["render"]
    assert renderer.renders == 2 * len(job.data.scene.views)
    assert again["render"].artifacts == runs["render"].artifacts


def test_a_depth_book_of_other_views_is_refused(job) -> None:
    runs = run_stages(job, last="depth")
    scene = replace(job.data.scene, views=job.data.scene.views[:-1])
    fewer = replace(job, data=replace(job.data, scene=scene))
    with pytest.raises(StoreError, match=r"depth book .* holds .*accepted"):
        compute_depth(job.store, {"render": runs["render"]}, {}, fewer)
