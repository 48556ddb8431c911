"""The control: an encoder that knows nothing, so that every choice of a patch is uniform."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np

from gvr_core.errors import ModelError
from gvr_core.models.base import FloatArray, Frame, Mask
from gvr_core.models.crops import to_uint8


class RandomEncoder:
    """Directions drawn uniformly from the unit sphere; nothing is learnt or looked at.

    A vector's generator is seeded by a digest of the seed and of the patch's pixels (or of the
    text). So results repeat exactly, in any order and on any machine, yet a vector says nothing
    about what a patch shows: patches that differ in one bit are as far apart as any two.
    What a benchmark scores with this encoder is what its geometry gives away for free.

    Args:
        seed: Which of the random encoders.
        dim: c, length of the vectors, at least 2.

    Raises:
        ModelError: if dim is below 2.
    """

    def __init__(self, seed: int = 0, dim: int = 384) -> None:
        if dim < 2:
            raise ModelError(f"dim is {dim}", accepted="2 or more")
        self._seed = seed
        self._dim = dim

    @property
    def name(self) -> str:
        """Name, version and settings."""
        return f"random/1(seed={self._seed},dim={self._dim})"

    @property
    def dim(self) -> int:
        """c: length of a vector."""
        return self._dim

    def encode_patches(self, frame: Frame, masks: Sequence[Mask]) -> FloatArray:
        """Random unit vectors (m, c) float32, one for each patch's pixels and outline."""
        rgb8 = to_uint8(frame.rgb)
        vectors = np.empty((len(masks), self._dim), np.float32)
        for i, mask in enumerate(masks):
            outline = np.packbits(mask.pixels).tobytes()
            vectors[i] = self._draw(b"patch", outline, rgb8[mask.pixels].tobytes())
        return vectors

    def encode_texts(self, texts: Sequence[str]) -> FloatArray:
        """Random unit vectors (t, c) float32, one for each text."""
        vectors = np.empty((len(texts), self._dim), np.float32)
        for i, text in enumerate(texts):
            vectors[i] = self._draw(b"text", text.encode())
        return vectors

    def _draw(self, *content: bytes) -> FloatArray:
        """A unit vector (c,) from the generator that belongs to a content."""
        digest = hashlib.blake2b(str(self._seed).encode(), digest_size=16)
        for part in content:
            # Lengths keep ("ab", "c") apart from ("a", "bc").
            digest.update(len(part).to_bytes(8, "little") + part)
        generator = np.random.Generator(np.random.PCG64(int.from_bytes(digest.digest(), "little")))
        vector = generator.standard_normal(self._dim)
        unit: FloatArray = (vector / np.linalg.norm(vector)).astype(np.float32)
        return unit
