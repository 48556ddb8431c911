"""Grounding DINO's network, built by its own library without a look-up."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property, lru_cache
from threading import RLock
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from gvr_core.errors import ModelError, some_of
from gvr_core.models.bert_folder import BertFolder
from gvr_core.models.checkpoints import Checkpoint, load_state

if TYPE_CHECKING:
    import torch

SEPARATORS = ".?"
"""Marks that end a phrase within a text; each phrase is read on its own."""

PUBLISHED_EXTRAS = ("label_enc.weight", "bert.embeddings.position_ids")
"""What the published checkpoints hold besides: an embedding for training, and a buffer that
transformers 4.31 and later no longer store."""

_BUILDING = RLock()
"""Building replaces functions of the library for a moment: one thread at a time."""


class SharedNetwork:
    """The library's network with the weights of a checkpoint, loaded when it is first needed.

    Args:
        keys: The library's configuration keys, as JSON.
        bert: Configuration and tokenizer of the text encoder.
        weights: The checkpoint.
        variant: What the keys are called in errors.
        device: Where it computes.
    """

    def __init__(
        self, keys: str, bert: BertFolder, weights: Checkpoint, variant: str, device: torch.device
    ) -> None:
        self._keys = keys
        self._bert = bert
        self._weights = weights
        self._variant = variant
        self._device = device
        self._lock = RLock()

    @contextmanager
    def taken(self) -> Iterator[Any]:
        """The ``GroundingDINO`` module, for one thread at a time.

        Its backbone keeps the size of the current picture in its parts, so that two pictures at
        once would be mixed up.

        Raises:
            ModelError: if a file is damaged or has changed, for keys that the library cannot use,
                or for tensors that are missing, unknown or of other sizes.
        """
        with self._lock:
            yield self._module

    @cached_property
    def _module(self) -> Any:
        state = load_state(self._weights)
        with _BUILDING:
            module = _built(json.loads(self._keys), self._bert)
        _fill(module, state, self._weights, self._variant)
        return module.eval().to(self._device)


@lru_cache(maxsize=2)
def shared_network(
    keys: str, bert: BertFolder, weights: Checkpoint, variant: str, device: torch.device
) -> SharedNetwork:
    """One network in a process for the same files, whatever the thresholds of its users."""
    return SharedNetwork(keys, bert, weights, variant, device)


def _built(keys: Mapping[str, Any], bert: BertFolder) -> Any:
    """The library's network with random weights, made without a look-up."""
    _quieten()
    from groundingdino.models import build_model

    tokenizer, language = bert.tokenizer(), bert.network()
    _check_tokens(tokenizer, language, bert)
    try:
        with _given_language(tokenizer, language):
            return build_model(SimpleNamespace(**{**keys, "text_encoder_type": str(bert.path)}))
    except Exception as error:  # the library asserts and indexes where a key does not suit it
        raise ModelError(
            f"the library builds no Grounding DINO of these keys: {type(error).__name__} {error}",
            accepted="keys as in the library's own configuration files",
        ) from error


@contextmanager
def _given_language(tokenizer: Any, language: Any) -> Iterator[None]:
    """Let the library take this tokenizer and this BERT in place of those that it would look up.

    Its constructor asks two functions of one module for them by name, and the second wants a file
    of BERT's weights, which the checkpoint holds anyway and which would be overwritten with them.
    """
    from groundingdino.util import get_tokenlizer

    own = (get_tokenlizer.get_tokenlizer, get_tokenlizer.get_pretrained_language_model)
    get_tokenlizer.get_tokenlizer = lambda _: tokenizer
    get_tokenlizer.get_pretrained_language_model = lambda _: language
    try:
        yield
    finally:
        get_tokenlizer.get_tokenlizer, get_tokenlizer.get_pretrained_language_model = own


def _check_tokens(tokenizer: Any, language: Any, bert: BertFolder) -> None:
    vocabulary = tokenizer.get_vocab()
    lacking = [t for t in ("[CLS]", "[SEP]", *SEPARATORS) if t not in vocabulary]
    if lacking:
        raise ModelError(f"the vocabulary lacks {' '.join(lacking)}", path=bert.path)
    if max(vocabulary.values()) >= language.config.vocab_size:
        raise ModelError(
            f"the tokenizer has {len(vocabulary)} tokens",
            path=bert.path,
            accepted=f"at most vocab_size = {language.config.vocab_size} of config.json",
        )


def _fill(network: Any, state: dict[str, torch.Tensor], weights: Checkpoint, variant: str) -> None:
    """Copy a checkpoint into a network, and refuse one that is not made for it.

    Buffers that the constructor computes may be missing, and so may further names of a tensor
    that the network has under several and the checkpoint under one.
    """
    own: dict[str, torch.Tensor] = network.state_dict()
    given = {own[name].data_ptr() for name in state if name in own}
    missing = [
        name
        for name, parameter in network.named_parameters(remove_duplicate=False)
        if name not in state and parameter.data_ptr() not in given
    ]
    unknown = [name for name in state if name not in own and name not in PUBLISHED_EXTRAS]
    unequal = [
        f"{name} {tuple(state[name].shape)} for {tuple(own[name].shape)}"
        for name in own
        if name in state and state[name].shape != own[name].shape
    ]
    kinds = (("lacks", missing), ("has unknown", unknown), ("differs in size:", unequal))
    faults = [f"{kind} {some_of(names)}" for kind, names in kinds if names]
    if faults:
        raise ModelError(
            f"is no checkpoint of this {variant}: it " + "; it ".join(faults),
            path=weights.path,
            accepted="a checkpoint of the same variant, configuration keys and BERT folder",
        )
    network.load_state_dict({k: v for k, v in state.items() if k in own}, strict=False)


def _quieten() -> None:
    """Silence what the library and those below it say about their own next versions.

    By message and module, for good: setting filters back would race with other threads.
    """
    import warnings

    for category, message, module in (
        (FutureWarning, "Importing from timm", r"timm\."),
        (FutureWarning, r"`torch\.cuda\.amp\.autocast", r"groundingdino\."),
        (FutureWarning, "The `device` argument is deprecated", r"transformers\."),
        (UserWarning, r"torch\.meshgrid: in an upcoming", r"torch\."),
    ):
        warnings.filterwarnings("ignore", message, category, module)
