"""Remembered texts: encoded once, one at a time, and forgotten within a bound."""

from __future__ import annotations

from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from gvr_core.models.conse import ConseEncoder
from gvr_core.models.text_memory import TextMemory


class Counting:
    """Encodes length and first letter, and counts what it was asked for."""

    def __init__(self) -> None:
        self.calls: Counter[str] = Counter()

    def __call__(self, text: str) -> np.ndarray:
        self.calls[text] += 1
        return np.array([len(text), ord(text[0]), 1], np.float32)


def test_each_text_is_encoded_once_and_rows_follow_the_texts() -> None:
    encode = Counting()
    memory = TextMemory(encode, 3)
    first = memory.vectors(["cup", "object", "cup"])
    assert first.dtype == np.float32
    assert first.tolist() == [[3, ord("c"), 1], [6, ord("o"), 1], [3, ord("c"), 1]]
    assert memory.vectors(["object", "spoon"]).tolist() == [[6, ord("o"), 1], [5, ord("s"), 1]]
    assert encode.calls == {"cup": 1, "object": 1, "spoon": 1}


def test_no_text_gives_no_row() -> None:
    encode = Counting()
    assert TextMemory(encode, 7).vectors([]).shape == (0, 7)
    assert not encode.calls


def test_what_was_not_asked_for_longest_is_forgotten() -> None:
    encode = Counting()
    memory = TextMemory(encode, 3, most_bytes=24)
    memory.vectors(["a", "b"])
    memory.vectors(["a"])  # now b is the oldest
    memory.vectors(["c"])
    memory.vectors(["a", "c"])
    assert encode.calls == {"a": 1, "b": 1, "c": 1}
    memory.vectors(["b"])
    assert encode.calls["b"] == 2


def test_more_texts_than_are_kept_come_out_right() -> None:
    texts = [letter * 3 for letter in "abcdefgh"] * 2
    rows = TextMemory(Counting(), 3, most_bytes=24).vectors(texts)
    assert rows[:, 1].tolist() == [ord(text[0]) for text in texts]


def test_callers_cannot_change_what_is_remembered() -> None:
    memory = TextMemory(Counting(), 3)
    memory.vectors(["cup"])[:] = 0
    assert memory.vectors(["cup"]).tolist() == [[3, ord("c"), 1]]


def test_threads_share_it() -> None:
    encode = Counting()
    memory = TextMemory(encode, 3, most_bytes=240)
    texts = [f"{letter}{i}" for letter in "abcdefgh" for i in range(8)]
    expected = TextMemory(Counting(), 3).vectors(texts)
    with ThreadPoolExecutor(8) as pool:
        for rows in pool.map(memory.vectors, [texts] * 40):
            assert np.array_equal(rows, expected)
    assert len(memory._known._values) == 20


def test_conse_encodes_its_canonical_phrases_once(monkeypatch: pytest.MonkeyPatch) -> None:
    encoder = ConseEncoder()
    embed, asked = encoder._sentences.embed, []

    def counting(texts: list[str]) -> np.ndarray:
        asked.append(list(texts))
        return embed(texts)

    monkeypatch.setattr(encoder._sentences, "embed", counting)
    phrases = ["object", "things", "stuff", "texture"]
    first = encoder.encode_texts(["a red cup", *phrases])
    second = encoder.encode_texts(["a very long text about a cat on a mat", *phrases])
    assert [text for (text,) in asked] == [
        "a red cup",
        *phrases,
        "a very long text about a cat on a mat",
    ]
    # The same bits, whichever query came first.
    assert np.array_equal(first[1:], second[1:])
    assert np.array_equal(ConseEncoder().encode_texts(phrases), first[1:])
    np.testing.assert_allclose(first, embed(["a red cup", *phrases]), atol=1e-6)
