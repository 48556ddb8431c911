"""From names in a configuration to models."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache
from threading import RLock

from pydantic import BaseModel, ConfigDict

from gvr_core.errors import unknown_name
from gvr_core.models.base import Encoder, Models, Segmenter, TextSegmenter
from gvr_core.models.conse import ConseEncoder, ConseSettings
from gvr_core.models.graph_segmenter import GraphSegmenter, GraphSettings
from gvr_core.models.random_encoder import RandomEncoder
from gvr_core.models.ranked_proposals import RankedProposals, RankedSettings


class ModelConfig(BaseModel):
    """Which models a method works with, and their settings."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    segmenter: str = "onboard-graph"
    """Cuts pictures into patches."""
    encoder: str = "onboard-conse"
    """Puts patches and texts into one space; ``"random:SEED"`` is the control."""
    text_segmenter: str = "onboard-ranked"
    """Text -> mask in one picture."""
    graph: GraphSettings = GraphSettings()
    """Settings of ``"onboard-graph"``."""
    conse: ConseSettings = ConseSettings()
    """Settings of ``"onboard-conse"``."""
    ranked: RankedSettings = RankedSettings()
    """Settings of ``"onboard-ranked"``."""


def _graph(config: ModelConfig) -> Segmenter:
    return _graph_segmenter(config.graph)


def _conse(config: ModelConfig) -> Encoder:
    return _conse_encoder(config.conse)


@lru_cache(maxsize=4)
def _graph_segmenter(settings: GraphSettings) -> Segmenter:
    return GraphSegmenter(settings)


@lru_cache(maxsize=4)
def _conse_encoder(settings: ConseSettings) -> Encoder:
    return ConseEncoder(settings)


def _random(name: str) -> Encoder | None:
    """The control, where a name is of the form ``random:SEED``."""
    match = re.fullmatch(r"random:(\d{1,18})", name)
    return RandomEncoder(int(match.group(1))) if match else None


def _ranked(config: ModelConfig, segmenter: Segmenter, encoder: Encoder) -> TextSegmenter:
    return RankedProposals(segmenter, encoder, config.ranked)


SEGMENTERS: dict[str, Callable[[ModelConfig], Segmenter]] = {"onboard-graph": _graph}
"""Segmenters by name."""

ENCODERS: dict[str, Callable[[ModelConfig], Encoder]] = {"onboard-conse": _conse}
"""Encoders by name; ``random:SEED`` comes on top."""

TEXT_SEGMENTERS: dict[str, Callable[[ModelConfig, Segmenter, Encoder], TextSegmenter]] = {
    "onboard-ranked": _ranked
}
"""Text segmenters by name, made from the other two models."""

_LOADING = RLock()
"""Two threads that want the same model wait for one loading."""


def check_models(config: ModelConfig) -> None:
    """Refuse names that are not known, without loading anything.

    Raises:
        ConfigError: listing the names that are.
    """
    if config.segmenter not in SEGMENTERS:
        raise unknown_name("segmenter", config.segmenter, SEGMENTERS)
    if config.text_segmenter not in TEXT_SEGMENTERS:
        raise unknown_name("text segmenter", config.text_segmenter, TEXT_SEGMENTERS)
    if config.encoder not in ENCODERS and _random(config.encoder) is None:
        raise unknown_name("encoder", config.encoder, [*ENCODERS, "random:SEED"])


def build_models(config: ModelConfig | None = None) -> Models:
    """The models of a configuration. Weights are loaded once a process and then shared.

    Args:
        config: Names and settings; the onboard models where none is given.

    Raises:
        ConfigError: for a name that is not known, listing those that are.
        ModelError: for weights that are missing or wrong.
    """
    config = config or ModelConfig()
    check_models(config)
    random = _random(config.encoder)
    with _LOADING:
        segmenter = SEGMENTERS[config.segmenter](config)
        encoder = random or ENCODERS[config.encoder](config)
        text_segmenter = TEXT_SEGMENTERS[config.text_segmenter](config, segmenter, encoder)
    return Models(segmenter, encoder, text_segmenter)
