"""ConSE: the classifier on real photographs, the sentence vectors, and both together."""

from __future__ import annotations

import socket

import numpy as np
import pytest
import skimage.data
from PIL import Image
from pydantic import ValidationError
from test_models_frames import BOXES, FRONT, trace

from gvr_core.errors import ModelError
from gvr_core.models.base import Frame, Mask
from gvr_core.models.conse import ConseEncoder, ConseSettings
from gvr_core.models.imagenet import INPUT_SIZE, ImageNetClassifier, class_names
from gvr_core.models.sentence import SentenceEmbedder

PHOTOGRAPHS = ("chelsea", "coffee", "rocket")
TEXTS = ("a cat", "a cup of coffee", "a rocket launch")


@pytest.fixture(scope="module")
def encoder() -> ConseEncoder:
    return ConseEncoder()


def photograph(name: str) -> tuple[Frame, Mask]:
    """A photograph as a frame, and all of it as a mask."""
    rgb = (getattr(skimage.data, name)() / 255).astype(np.float32)
    shape = rgb.shape[:2]
    return Frame(rgb, np.zeros(shape, np.float32), FRONT), Mask(np.ones(shape, np.bool_))


def pictures(*names: str) -> np.ndarray:
    """Photographs in the classifier's size."""
    loaded = [Image.fromarray(getattr(skimage.data, name)()) for name in names]
    return np.stack([np.asarray(p.resize((INPUT_SIZE, INPUT_SIZE))) for p in loaded])


def test_class_names_are_in_the_order_of_the_network() -> None:
    names = class_names()
    assert len(names) == 1000
    posterior = ImageNetClassifier().posterior(pictures("chelsea", "coffee"))
    cat, coffee = ({names[i] for i in np.argsort(-row)[:3]} for row in posterior)
    assert {"Egyptian Mau", "tabby cat", "tiger cat"} == cat
    assert "espresso" in coffee
    assert posterior[1].max() > 0.7


def test_posteriors_are_distributions_whatever_the_batch() -> None:
    classifier = ImageNetClassifier()
    three = pictures("chelsea", "coffee", "rocket")
    many = classifier.posterior(np.concatenate([three] * 4))
    assert many.dtype == np.float32 and many.shape == (12, 1000)
    np.testing.assert_allclose(many.sum(axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(many[:3], classifier.posterior(three), atol=1e-5)
    np.testing.assert_allclose(many[:3], many[9:], atol=1e-5)
    assert classifier.posterior(three[:0]).shape == (0, 1000)
    with pytest.raises(ModelError, match=r"\(m, 260, 260, 3\)"):
        classifier.posterior(three[:, :100])


def test_folding_normalisation_into_convolutions_changes_nothing() -> None:
    import torch
    from efficientnet_lite_pytorch import EfficientNet

    from gvr_core.models.checkpoints import installed_file, load_torch_state
    from gvr_core.models.imagenet import PACKAGE, WEIGHTS_FILE, WEIGHTS_SHA256

    plain = EfficientNet.from_name("efficientnet-lite2")
    plain.load_state_dict(load_torch_state(installed_file(PACKAGE, WEIGHTS_FILE), WEIGHTS_SHA256))
    plain.eval()
    batch = pictures("chelsea", "rocket")
    with torch.inference_mode():
        values = (torch.from_numpy(batch).permute(0, 3, 1, 2).float() - 127) / 128
        expected = plain(values).softmax(dim=1).numpy()
    np.testing.assert_allclose(ImageNetClassifier().posterior(batch), expected, atol=1e-5)


def test_sentences_are_unit_vectors_that_know_meaning() -> None:
    embedder = SentenceEmbedder()
    texts = ["a cat", "a kitten", "a submarine", "", "cat " * 400]
    vectors = embedder.embed(texts)
    assert vectors.shape == (5, 384) and vectors.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-5)
    assert vectors[0] @ vectors[1] > 0.6 > 0.4 > vectors[0] @ vectors[2]
    # Padding beside a longer text has no say.
    np.testing.assert_allclose(embedder.embed(["a cat"])[0], vectors[0], atol=1e-5)
    assert embedder.embed([]).shape == (0, 384)


def test_photographs_and_texts_find_each_other(encoder: ConseEncoder) -> None:
    vectors = np.concatenate(
        [encoder.encode_patches(f, [m]) for f, m in map(photograph, PHOTOGRAPHS)]
    )
    similarity = vectors @ encoder.encode_texts(TEXTS).T
    assert similarity.argmax(axis=1).tolist() == [0, 1, 2]
    assert similarity.argmax(axis=0).tolist() == [0, 1, 2]


def test_patches_of_a_frame_are_told_apart(encoder: ConseEncoder) -> None:
    frame, shows = trace(FRONT)
    masks = [Mask(shows == i) for i in range(len(BOXES))]
    vectors = encoder.encode_patches(frame, masks)
    assert vectors.shape == (4, encoder.dim) and vectors.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-5)
    best = (vectors @ encoder.encode_texts(["a cat", "a cup of coffee"]).T).argmax(axis=0)
    assert best.tolist() == [0, 1]


def test_encoding_repeats_exactly(encoder: ConseEncoder) -> None:
    frame, shows = trace(FRONT)
    masks = [Mask(shows == i) for i in range(3)]
    first, second = (encoder.encode_patches(frame, masks) for _ in range(2))
    assert np.array_equal(first, second)


def test_the_combination_is_the_one_of_the_paper(encoder: ConseEncoder) -> None:
    rng = np.random.default_rng(0)
    posterior = rng.dirichlet(np.full(1000, 0.05), size=3).astype(np.float32)
    names = np.array(class_names())
    # Slow and obvious: for each row, sum p(y_t | x) s(y_t) over the ten largest.
    for row, vector in zip(posterior, encoder.combine(posterior), strict=True):
        top = sorted(range(1000), key=lambda i: (-row[i], i))[:10]
        weights = np.array([float(row[i]) for i in top])
        expected = weights @ encoder.encode_texts(names[top].tolist()) / weights.sum()
        np.testing.assert_allclose(vector, expected / np.linalg.norm(expected), atol=1e-5)


def test_a_certain_posterior_gives_the_class_name(encoder: ConseEncoder) -> None:
    posterior = np.zeros((1, 1000), np.float32)
    posterior[0, 285] = 1
    name = class_names()[285]
    assert name == "Egyptian Mau"
    np.testing.assert_allclose(encoder.combine(posterior), encoder.encode_texts([name]), atol=1e-5)


def test_no_patch_and_an_empty_patch(encoder: ConseEncoder) -> None:
    frame, shows = trace(FRONT)
    assert encoder.encode_patches(frame, []).shape == (0, 384)
    vector = encoder.encode_patches(frame, [Mask(np.zeros(shows.shape, np.bool_))])
    assert np.isfinite(vector).all() and np.linalg.norm(vector) == pytest.approx(1, abs=1e-5)


def test_the_name_says_conse_and_tells_settings_apart(encoder: ConseEncoder) -> None:
    assert encoder.name.startswith("onboard-conse/")
    assert "9656183e" in encoder.name and "53aa5117" in encoder.name
    assert "clip" not in encoder.name.lower()
    other = ConseEncoder(ConseSettings(crops=("masked", "bbox"), top_t=5))
    assert other.name != encoder.name
    frame, shows = trace(FRONT)
    masks = [Mask(shows == 0)]
    assert not np.allclose(other.encode_patches(frame, masks), encoder.encode_patches(frame, masks))


@pytest.mark.parametrize(
    "bad", [{"top_t": 0}, {"crops": ()}, {"crops": ("round",)}, {"crops": ("round", "masked")}]
)
def test_impossible_settings_are_refused(bad: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        ConseSettings.model_validate(bad)


def test_loading_needs_no_network(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> None:
        raise AssertionError("a socket was opened")

    for name in ("connect", "connect_ex", "sendto"):
        monkeypatch.setattr(socket.socket, name, refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    frame, mask = photograph("chelsea")
    encoder = ConseEncoder()
    cat, submarine = (
        encoder.encode_texts(["a cat", "a submarine"]) @ encoder.encode_patches(frame, [mask])[0]
    )
    assert cat > submarine
