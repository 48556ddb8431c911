"""open_clip behind the Encoder protocol: what it gives is what the library itself gives."""

from __future__ import annotations

import logging
import socket
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import load_file, save_file
from tiny_open_clip import (
    TEXTS,
    TinyOpenClip,
    encoder,
    five_masks,
    library_patches,
    noise_frame,
    unit,
    write_tiny_open_clip,
)

from gvr_core.errors import ModelError
from gvr_core.models import devices, open_clip_encoder
from gvr_core.models.base import Frame, Mask
from gvr_core.models.checkpoints import checkpoint
from gvr_core.models.open_clip_encoder import OpenClipEncoder, OpenClipSettings
from gvr_core.models.open_clip_network import load_network


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> TinyOpenClip:
    return write_tiny_open_clip(tmp_path_factory.mktemp("tiny"))


@pytest.fixture(scope="module")
def frame() -> Frame:
    return noise_frame()


@pytest.fixture(scope="module")
def masks() -> list[Mask]:
    return five_masks()


@pytest.mark.parametrize("mode", ["masked", "bbox", "context"])
def test_patches_are_encoded_as_the_library_does(
    mode: str, tiny: TinyOpenClip, frame: Frame, masks: list[Mask]
) -> None:
    vectors = encoder(tiny, crops=(mode,)).encode_patches(frame, masks)
    assert vectors.shape == (5, 32) and vectors.dtype == np.float32
    expected = unit(library_patches(tiny, frame, masks, mode))
    np.testing.assert_allclose(vectors, expected, atol=1e-6)
    assert np.abs(expected[0] - expected[1]).max() > 0.01  # the model tells patches apart


def test_several_crops_are_averaged_before_they_are_normalised(
    tiny: TinyOpenClip, frame: Frame, masks: list[Mask]
) -> None:
    vectors = encoder(tiny, crops=("masked", "context")).encode_patches(frame, masks)
    parts = [library_patches(tiny, frame, masks, mode) for mode in ("masked", "context")]
    np.testing.assert_allclose(vectors, unit((parts[0] + parts[1]) / 2), atol=1e-6)


def test_the_models_own_preprocessing_is_followed(
    tmp_path: Path, frame: Frame, masks: list[Mask]
) -> None:
    own = {"mean": [0.2, 0.5, 0.8], "std": [0.1, 0.2, 0.3], "interpolation": "bilinear"}
    files = write_tiny_open_clip(tmp_path, preprocess=own)
    for fill, colour in (("black", (0, 0, 0)), ("mean", (51, 128, 204))):
        vectors = encoder(files, fill=fill).encode_patches(frame, masks)
        expected = library_patches(files, frame, masks, "masked", colour)
        np.testing.assert_allclose(vectors, unit(expected), atol=1e-6)


def test_texts_are_encoded_as_the_library_does(tiny: TinyOpenClip) -> None:
    model, _, tokenizer = tiny.library_model()
    with torch.inference_mode():
        expected = unit(model.encode_text(tokenizer(TEXTS), normalize=False))
    subject = encoder(tiny)
    vectors = subject.encode_texts(TEXTS)
    assert vectors.dtype == np.float32
    np.testing.assert_allclose(vectors, expected, atol=1e-6)
    assert subject.encode_texts([]).shape == (0, 32)


@pytest.mark.parametrize("batch", [1, 3])
def test_the_size_of_batches_does_not_matter(
    batch: int, tiny: TinyOpenClip, frame: Frame, masks: list[Mask]
) -> None:
    many = masks * 3
    expected = encoder(tiny).encode_patches(frame, many)
    found = encoder(tiny, batch=batch).encode_patches(frame, many)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    np.testing.assert_allclose(expected[:5], expected[10:], atol=1e-6)


def test_out_of_memory_halves_the_batch_and_says_so(
    tiny: TinyOpenClip,
    frame: Frame,
    masks: list[Mask],
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    expected = encoder(tiny).encode_patches(frame, masks)
    subject = encoder(tiny, batch=4)
    model, sizes = subject._network.model, []
    encode_image = model.encode_image

    def small_device(batch: torch.Tensor, normalize: bool) -> torch.Tensor:
        sizes.append(len(batch))
        if len(batch) > 2:
            raise torch.cuda.OutOfMemoryError("CUDA out of memory")
        return encode_image(batch, normalize=normalize)

    monkeypatch.setattr(model, "encode_image", small_device)
    with caplog.at_level(logging.WARNING, devices.__name__):
        vectors = subject.encode_patches(frame, masks)
    np.testing.assert_allclose(vectors, expected, atol=1e-6)
    assert sizes == [4, 2, 2, 1]
    assert "ran out of memory with 4 patches at once; going on with 2" in caplog.text


def test_no_patch_an_empty_patch_and_a_wrong_one(
    tiny: TinyOpenClip, frame: Frame, masks: list[Mask]
) -> None:
    subject = encoder(tiny)
    assert subject.encode_patches(frame, []).shape == (0, 32)
    vector = subject.encode_patches(frame, [Mask(np.zeros((50, 70), np.bool_))])
    model, preprocess, _ = tiny.library_model()
    with torch.inference_mode():
        black = unit(model.encode_image(preprocess(Image.new("RGB", (9, 9)))[None]))
    np.testing.assert_allclose(vector, black, atol=1e-6)
    with pytest.raises(ModelError, match=r"mask 1 has shape \(4, 4\)"):
        subject.encode_patches(frame, [masks[0], Mask(np.ones((4, 4), np.bool_))])


def test_vectors_of_zeros_stay_and_infinite_ones_are_refused(
    tiny: TinyOpenClip, tmp_path: Path, frame: Frame, masks: list[Mask]
) -> None:
    def constant(value: float) -> OpenClipEncoder:
        state = load_file(tiny.safetensors)
        state["visual.proj"].fill_(value)
        state["text_projection"].fill_(value)
        path = tmp_path / f"{value}.safetensors"
        save_file(state, path)
        return encoder(tiny, path)

    assert (constant(0).encode_patches(frame, masks) == 0).all()
    assert (constant(0).encode_texts(TEXTS) == 0).all()
    with pytest.raises(ModelError, match=r"not finite.*other weights"):
        constant(np.inf).encode_patches(frame, masks)
    with pytest.raises(ModelError, match=r"not finite.*other weights"):
        constant(np.inf).encode_texts(TEXTS)


@pytest.mark.parametrize("precision", ["fp16", "bf16"])
def test_half_precision_is_close(
    precision: str, tiny: TinyOpenClip, frame: Frame, masks: list[Mask]
) -> None:
    full, half = encoder(tiny), encoder(tiny, precision=precision)
    pairs = [
        (full.encode_patches(frame, masks), half.encode_patches(frame, masks)),
        (full.encode_texts(TEXTS), half.encode_texts(TEXTS)),
    ]
    for expected, found in pairs:
        assert found.dtype == np.float32 and not np.array_equal(found, expected)
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-5)
        assert (found * expected).sum(axis=1).min() > 0.999


def test_automatic_precision_follows_the_device(
    tiny: TinyOpenClip, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "precision=fp32" in encoder(tiny).name
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    settings = OpenClipSettings(config=tiny.config)
    on_cuda = OpenClipEncoder("tiny", "mine", checkpoint(tiny.safetensors), settings)
    assert "precision=fp16" in on_cuda.name


def test_texts_are_encoded_once(tiny: TinyOpenClip, monkeypatch: pytest.MonkeyPatch) -> None:
    subject = encoder(tiny)
    tokenized: Counter[str] = Counter()
    network = subject._network
    tokenizer = network.tokenizer

    def counting(texts: list[str]) -> torch.Tensor:
        tokenized.update(texts)
        return tokenizer(texts)

    object.__setattr__(network, "tokenizer", counting)
    phrases = ["object", "things", "stuff", "texture"]
    first = subject.encode_texts(["a cup", *phrases])
    second = subject.encode_texts(["a cat", *phrases])
    assert tokenized == Counter(["a cup", "a cat", *phrases])
    assert np.array_equal(first[1:], second[1:])


def test_threads_load_once(
    tiny: TinyOpenClip, frame: Frame, masks: list[Mask], monkeypatch: pytest.MonkeyPatch
) -> None:
    loadings = []

    def counting(*args: Any) -> Any:
        loadings.append(args)
        return load_network(*args)

    monkeypatch.setattr(open_clip_encoder, "load_network", counting)
    subject = encoder(tiny)
    with ThreadPoolExecutor(4) as pool:
        texts = pool.map(lambda _: subject.encode_texts(TEXTS), range(4))
        found = list(pool.map(lambda _: subject.encode_patches(frame, masks), range(4)))
    assert len(loadings) == 1
    assert all(np.array_equal(rows, subject.encode_texts(TEXTS)) for rows in texts)
    assert all(np.array_equal(rows, found[0]) for rows in found)


def test_nothing_is_looked_up(
    tiny: TinyOpenClip, frame: Frame, masks: list[Mask], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*args: object) -> None:
        raise AssertionError("a connection was tried")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    subject = encoder(tiny)
    assert subject.encode_patches(frame, masks).shape == (5, 32)
    assert subject.encode_texts(TEXTS).shape == (3, 32)
