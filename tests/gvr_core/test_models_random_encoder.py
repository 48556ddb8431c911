"""The control encoder: reproducible, uniform, blind."""

from __future__ import annotations

import numpy as np
import pytest
import skimage.data
from test_models_frames import FRONT, LEFT, trace

from gvr_core.errors import ModelError
from gvr_core.models.base import Mask
from gvr_core.models.random_encoder import RandomEncoder


def patches(shows: np.ndarray) -> list[Mask]:
    return [Mask(shows == value) for value in np.unique(shows)]


def test_vectors_are_unit_float32_and_repeat_exactly() -> None:
    frame, shows = trace(FRONT)
    first, second = (RandomEncoder(3, 64).encode_patches(frame, patches(shows)) for _ in range(2))
    assert first.dtype == np.float32 and first.shape == (len(patches(shows)), 64)
    np.testing.assert_allclose(np.linalg.norm(first, axis=1), 1, atol=1e-6)
    assert np.array_equal(first, second)
    texts = RandomEncoder(3, 64).encode_texts(["a cat", "a dog", "a cat"])
    assert texts.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(texts, axis=1), 1, atol=1e-6)
    assert np.array_equal(texts[0], texts[2]) and not np.allclose(texts[0], texts[1])


def test_a_vector_does_not_depend_on_its_neighbours() -> None:
    frame, shows = trace(FRONT)
    masks = patches(shows)
    together = RandomEncoder().encode_patches(frame, masks)
    alone = RandomEncoder().encode_patches(frame, masks[2:3])
    assert np.array_equal(alone[0], together[2])


def test_seeds_views_and_texts_have_vectors_of_their_own() -> None:
    frame, shows = trace(FRONT)
    other, shows_other = trace(LEFT)
    a = RandomEncoder(0).encode_patches(frame, [Mask(shows == 0)])[0]
    b = RandomEncoder(1).encode_patches(frame, [Mask(shows == 0)])[0]
    c = RandomEncoder(0).encode_patches(other, [Mask(shows_other == 0)])[0]
    d = RandomEncoder(0).encode_texts([""])[0]
    similar = [abs(float(x @ y)) for x, y in [(a, b), (a, c), (b, c), (a, d)]]
    assert max(similar) < 0.3


def test_every_patch_is_chosen_equally_often() -> None:
    frame, shows = trace(FRONT)
    masks = [Mask(shows == i) for i in range(4)]
    texts = [f"text {i}" for i in range(100)]
    counts = np.zeros(4)
    for seed in range(40):
        encoder = RandomEncoder(seed, 16)
        best = (encoder.encode_texts(texts) @ encoder.encode_patches(frame, masks).T).argmax(axis=1)
        counts += np.bincount(best, minlength=4)
    # Choices of one seed share four patch vectors, so they scatter more than 4000 free draws.
    assert np.abs(counts / counts.sum() - 0.25).max() < 0.05


def test_directions_are_uniform() -> None:
    vectors = RandomEncoder(0, 8).encode_texts([str(i) for i in range(4000)])
    np.testing.assert_allclose(vectors.mean(axis=0), 0, atol=0.03)
    np.testing.assert_allclose(vectors.T @ vectors / 4000, np.eye(8) / 8, atol=0.02)


def test_it_is_blind_to_what_a_patch_shows() -> None:
    frame, _ = trace(FRONT)
    rgb = np.array(skimage.data.chelsea()[:240, :320] / 255, np.float32)
    brighter = np.clip(rgb + np.float32(0.02), 0, 1)
    mask = [Mask(np.ones((240, 320), np.bool_))]
    a, b = (
        RandomEncoder().encode_patches(type(frame)(x, frame.depth, frame.camera), mask)[0]
        for x in (rgb, brighter)
    )
    assert abs(float(a @ b)) < 0.3


def test_empty_input_and_bad_settings() -> None:
    frame, _ = trace(FRONT)
    encoder = RandomEncoder(0, 5)
    assert encoder.encode_patches(frame, []).shape == (0, 5)
    assert encoder.encode_texts([]).shape == (0, 5)
    assert encoder.dim == 5 and "seed=0" in encoder.name
    assert encoder.name != RandomEncoder(1, 5).name
    with pytest.raises(ModelError, match="dim is 1"):
        RandomEncoder(0, 1)
