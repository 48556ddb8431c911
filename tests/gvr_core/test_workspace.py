"""Queries that share a workspace, and the same ones alone: the same answers to the last bit."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from oracle_boxes import ABSENT, BLUE, RED, World, boxes

import gvr_core.workspace
from gvr_core.errors import InputError
from gvr_core.localize import TEXTS_A_BLOCK
from gvr_core.methods import MethodConfig, Toolbox, build_method
from gvr_core.models.base import Frame, Mask
from gvr_core.models.random_encoder import RandomEncoder
from gvr_core.scene import Query
from gvr_core.workspace import Workspace

QUERIES = [RED, BLUE, ABSENT, *(Query(id=f"q{i}", text=f"text {i}") for i in range(20))]


@pytest.fixture(scope="module")
def world() -> World:
    return boxes()


class Everything:
    """Test double: whatever the text, all that is drawn."""

    name = "everything"

    def segment(self, frame: Frame, text: str) -> Mask:
        return Mask(frame.alpha > 0.5, 0.7)


@pytest.mark.parametrize("name", ["gvr-paper", "gvr-robust", "lift"])
def test_answers_do_not_depend_on_who_shares(world, name) -> None:
    tools = world.method(name).tools
    encoder = RandomEncoder(0, 24)
    models = replace(tools.models, encoder=encoder, text_segmenter=Everything())
    config = MethodConfig(method=name, robust={"refusal": False})
    method = build_method(config, Toolbox(tools.renderer, models))
    books = method.prepare(world.scene)
    shared = method.share(world.scene, books, QUERIES)
    found = 0
    for query in (*QUERIES[:6], QUERIES[-1]):
        place = method.locate(world.scene, books, query, shared)
        together = method.segment(world.scene, books, place, query, shared)
        alone = method.ground(world.scene, books, query)
        np.testing.assert_array_equal(together.flags, alone.flags)
        np.testing.assert_array_equal(together.scores, alone.scores)
        assert together.confidence == alone.confidence
        assert (together.location is None) == (alone.location is None)
        if together.location is not None:
            np.testing.assert_array_equal(together.location, alone.location)
        found += alone.found
    assert found > 1
    assert shared.shared_seconds > 0


class CountingEncoder(RandomEncoder):
    """Test double: counts how often texts are encoded."""

    calls = 0

    def encode_texts(self, texts):
        self.calls += 1
        return super().encode_texts(texts)


def test_texts_are_encoded_together_and_once() -> None:
    encoder = CountingEncoder(0, 8)
    features = np.random.default_rng(0).normal(size=(50, 8)).astype(np.float32)
    workspace = Workspace(features, encoder, ["a", "b", "a", "c"])
    assert encoder.calls == 0
    for text in "abcba":
        expected = features @ encoder.encode_texts([text])[0]
        np.testing.assert_allclose(workspace.cosines(text), expected, atol=1e-6)
    assert encoder.calls == 1 + 5
    with pytest.raises(InputError, match="'d'"):
        workspace.cosines("d")
    with pytest.raises(InputError, match="'a'"):
        Workspace(features, None).cosines("a")


def test_little_memory_changes_no_bit() -> None:
    encoder = RandomEncoder(0, 8)
    features = np.random.default_rng(0).normal(size=(300, 8)).astype(np.float32)
    texts = [f"text {i}" for i in range(3 * TEXTS_A_BLOCK + 1)]
    roomy, tight = Workspace(features, encoder, texts), Workspace(features, encoder, texts, 1)
    for text in (*texts, *texts[::-7]):
        np.testing.assert_array_equal(roomy.cosines(text), tight.cosines(text))


def test_what_is_recalled_is_made_once_and_its_time_is_shared() -> None:
    workspace, made = Workspace(np.empty((0, 2), np.float32), None), []

    def make() -> np.ndarray:
        made.append(1)
        return np.arange(3, dtype=np.float32)

    first = workspace.recall(b"key", make)
    seconds = workspace.shared_seconds
    assert workspace.recall(b"key", make) is first and len(made) == 1
    assert 0 < seconds == workspace.shared_seconds


def test_shared_seconds_count_once_for_makers_at_the_same_time_or_in_each_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [0.0]
    monkeypatch.setattr(gvr_core.workspace.time, "perf_counter", lambda: now[0])
    shared = Workspace(np.zeros((1, 2), np.float32), None)
    both = threading.Barrier(2)

    def beside() -> np.ndarray:
        both.wait(60)
        now[0] = 10.0
        return np.zeros(1, np.float32)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda key: shared.recall(key, beside), (b"a", b"b")))
    assert shared.shared_seconds == 10

    def inner() -> np.ndarray:
        now[0] += 2
        return np.zeros(1, np.float32)

    def outer() -> np.ndarray:
        now[0] += 1
        return shared.recall(b"inner", inner)

    shared.recall(b"outer", outer)
    shared.recall(b"outer", outer)
    assert shared.shared_seconds == 13
