"""The evidence that the stages keep: it is what the method saw, in small."""

from __future__ import annotations

import base64
import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from native_scene import parts, written
from PIL import Image, ImageDraw

from datasets.base import SceneData
from datasets.native import read_scene
from gvr_core.methods import MethodConfig, Toolbox, build_method
from gvr_core.models.oracle import OracleWorld, oracle_models
from gvr_core.rendering import get_renderer
from reports.evidence import SceneEvidence, outline_path, thumbnail_size
from tasks.scene_job import SceneJob
from tasks.stages import run_stages
from tasks.store import Store


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> SceneData:
    return read_scene(written(tmp_path_factory.mktemp("data") / "two-boxes", **parts(views=6)))


@pytest.fixture(scope="module")
def job(data: SceneData, tmp_path_factory: pytest.TempPathFactory) -> SceneJob:
    truth = data.truth
    assert truth.labels is not None
    meanings = {query.text: query.target for query in data.queries if query.target}
    world = OracleWorld(data.scene.gaussians, truth.labels, truth.objects, meanings, "ab" * 32)
    tools = Toolbox(get_renderer("numba"), oracle_models(world))
    store = Store(tmp_path_factory.mktemp("store"))
    return SceneJob(store, data, data.queries, MethodConfig(), tools, evidence=True)


def evidence_of(job: SceneJob) -> SceneEvidence:
    content = job.store.load_bytes(run_stages(job)["evaluate"]["evidence"])
    return SceneEvidence.model_validate_json(content)


def filled(path: str, size: tuple[int, int]) -> np.ndarray:
    """The mask that an SVG path encloses, drawn by Pillow; its parts have no holes here."""
    image = Image.new("1", size)
    for part in path.split("Z")[:-1]:
        numbers = [float(number) for number in re.findall(r"-?[0-9.]+", part)]
        ImageDraw.Draw(image).polygon(list(zip(numbers[::2], numbers[1::2], strict=True)), fill=1)
    return np.array(image)


def pixels(picture) -> np.ndarray:
    image = Image.open(io.BytesIO(base64.b64decode(picture.webp)))
    assert image.format == "WEBP" and image.size == (picture.width, picture.height)
    return np.array(image.convert("RGB")).astype(int)


def test_votes_and_virtual_views_are_those_of_the_method(job: SceneJob) -> None:
    evidence = evidence_of(job)
    method = build_method(job.method, job.tools)
    books = method.prepare(job.data.scene)
    assert [query.query for query in evidence.queries] == [query.id for query in job.queries]
    for query, kept in zip(job.queries, evidence.queries, strict=True):
        answer = method.ground(job.data.scene, books, query)
        place = answer.localization
        assert place is not None and len(kept.votes) == len(place.retrieval.views)
        scores = [vote.score for vote in kept.votes]
        assert scores == sorted(scores, reverse=True)
        for vote in kept.votes:
            (j,) = np.flatnonzero(place.retrieval.views == vote.view)
            assert vote.score == pytest.approx(float(place.retrieval.relevancies[j]), rel=1e-4)
            assert vote.point == pytest.approx(place.retrieval.points[j], rel=1e-5, abs=1e-5)
            assert vote.place == place.labels[j]
            mask = books.semantics.patches.pixels(int(place.retrieval.patches[j]))
            drawn = filled(vote.outline, mask.shape[::-1])
            assert (drawn & mask).sum() / (drawn | mask).sum() > 0.9
            assert evidence.cameras[vote.view].picture is not None
        virtual = [*([answer.bev] if answer.bev else []), *answer.ring]
        roles = ["bev"] * bool(answer.bev) + ["ring"] * len(answer.ring)
        assert [view.role for view in kept.virtual] == roles
        for view, shown in zip(virtual, kept.virtual, strict=True):
            assert (shown.outline is None) is (view.mask is None)
            wanted = np.rint(view.frame.rgb * 255)
            assert np.abs(pixels(shown) - wanted).mean() < 8, "lossy, and the same picture"


def test_answers_are_drawn_in_each_test_view_with_the_truth(job: SceneJob) -> None:
    data, evidence = job.data, evidence_of(job)
    for query, kept in zip(job.queries, evidence.queries, strict=True):
        if query.target is None:
            assert all(final.outline is None for final in kept.finals)
            continue
        views = [v for v in data.truth.test_views if data.truth.is_labelled(v, query.target)]
        assert [final.view for final in kept.finals] == [view.name for view in views]
        for view, final in zip(views, kept.finals, strict=True):
            truth = data.truth.mask(view, query.target)
            drawn = filled(final.outline or "", truth.shape[::-1])
            assert (drawn & truth).sum() / max(1, (drawn | truth).sum()) > 0.85
            shown = pixels(final)
            red = (shown[..., 0] > 180) & (shown[..., 1] < 90) & (shown[..., 2] < 90)
            if query.target == "blue box":  # the other box is red by itself
                assert (red & truth).sum() > 0.6 * truth.sum()


def test_without_evidence_none_is_kept_and_the_scores_are_the_same(job: SceneJob) -> None:
    runs, bare = run_stages(job), run_stages(replace(job, evidence=False))
    assert "evidence" in runs["evaluate"].artifacts
    assert "evidence" not in bare["evaluate"].artifacts
    assert runs["evaluate"]["rows"].digest == bare["evaluate"]["rows"].digest
    assert all(bare[name].cached for name in bare if name != "evaluate")


@pytest.mark.parametrize("name", ["lift", "gvr-robust"])
def test_methods_of_other_kinds_keep_what_they_have(job: SceneJob, name: str) -> None:
    evidence = evidence_of(replace(job, method=MethodConfig(method=name)))
    assert all(bool(query.finals) for query in evidence.queries)
    has_votes = any(query.votes for query in evidence.queries)
    assert has_votes is (name == "gvr-robust")
    if name == "lift":
        assert not any(query.virtual for query in evidence.queries)
        assert all(camera.picture is None for camera in evidence.cameras)


def test_a_scene_takes_little_room(job: SceneJob, tmp_path: Path) -> None:
    evidence = evidence_of(job)
    per_query = len(evidence.model_dump_json()) / len(evidence.queries)
    assert per_query < 150_000


def test_outlines_have_the_holes_of_their_masks() -> None:
    mask = np.zeros((60, 80), np.bool_)
    mask[10:50, 10:70] = True
    mask[20:40, 30:50] = False
    path = outline_path(mask, (80, 60))
    assert path.count("M") == path.count("Z") == 2
    assert outline_path(np.zeros((6, 8), np.bool_), (8, 6)) == ""
    half = outline_path(mask, thumbnail_size(80, 60, 40))
    numbers = [float(number) for number in re.findall(r"[0-9.]+", half)]
    assert max(numbers) <= 36 and min(numbers) >= 5
