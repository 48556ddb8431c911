"""How much like a text a patch is, compared with how much like anything at all it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]


def relevancy(query: FloatArray, phrases: FloatArray, temperature: float) -> FloatArray:
    """Relevancy of every patch: the worst of its pairwise softmaxes against canonical phrases.

    min over i of exp(t q) / (exp(t q) + exp(t n_i)), with q the cosine with the query and n_i
    those with the phrases. Above 0.5, the patch is more like the query than like each phrase.
    Source: Kerr et al., "LERF: Language Embedded Radiance Fields" (ICCV 2023), section 3.3.

    Args:
        query: (M,) cosines with the query.
        phrases: (p, M) cosines with the phrases, p >= 1.
        temperature: t.

    Returns:
        (M,) in (0, 1).
    """
    return softmax(over_phrases(query, phrases), temperature)


def contrast(query: FloatArray, temperature: float) -> FloatArray:
    """Relevancy without canonical phrases: a patch against the scene's typical one.

    The softmax between a patch's cosine with the query and the median cosine of all patches:
    some queries are a little like everything, and that says nothing about any patch.

    Args:
        query: (M,) cosines with the query.
        temperature: t.

    Returns:
        (M,) in (0, 1).
    """
    return softmax(over_typical(query), temperature)


def over_phrases(query: FloatArray, phrases: FloatArray) -> FloatArray:
    """By how much cosines (M,) with the query exceed the best ones with phrases (p, M)."""
    return np.asarray(query - phrases.max(axis=0))


def over_typical(query: FloatArray) -> FloatArray:
    """By how much cosines (M,) with the query exceed the median one."""
    return np.asarray(query - np.median(query)) if len(query) else query


def softmax(margin: FloatArray, temperature: float) -> FloatArray:
    """1 / (1 + exp(-t m)) of margins m, float32: the softmax between two cosines m apart."""
    scores: FloatArray = (1 / (1 + np.exp(-np.float32(temperature) * margin))).astype(np.float32)
    return scores
