"""From names in a configuration to models."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache
from threading import RLock

from pydantic import BaseModel, ConfigDict

from gvr_core.errors import ConfigError, unknown_name
from gvr_core.models.base import Encoder, Models, Segmenter, TextSegmenter
from gvr_core.models.conse import ConseEncoder, ConseSettings
from gvr_core.models.graph_segmenter import GraphSegmenter, GraphSettings
from gvr_core.models.oracle import (
    OracleEncoder,
    OracleSegmenter,
    OracleTextSegmenter,
    OracleWorld,
)
from gvr_core.models.random_encoder import RandomEncoder
from gvr_core.models.ranked_proposals import RankedProposals, RankedSettings

ORACLE = "oracle"
"""Name of the models that know the truth; they need a scene with 3D labels."""


class ModelConfig(BaseModel):
    """Which models a method works with, and their settings."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    segmenter: str = "onboard-graph"
    """Cuts pictures into patches; ``"oracle"`` knows the truth."""
    encoder: str = "onboard-conse"
    """Puts patches and texts into one space; ``"random:SEED"`` is the control, ``"oracle"`` knows
    the truth."""
    text_segmenter: str = "onboard-ranked"
    """Text -> mask in one picture; ``"oracle"`` knows the truth."""
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
    # mypy cannot see that models are hashable, as all objects without an __eq__ are
    return _ranked_proposals(segmenter, encoder, config.ranked)  # type: ignore[arg-type]


@lru_cache(maxsize=4)
def _ranked_proposals(
    segmenter: Segmenter, encoder: Encoder, settings: RankedSettings
) -> TextSegmenter:
    """One for each pair of models, so that lines of a suite share the frames it remembers."""
    return RankedProposals(segmenter, encoder, settings)


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


def needs_world(config: ModelConfig) -> bool:
    """Whether one of the models is an oracle, which has to be told the truth."""
    return ORACLE in (config.segmenter, config.encoder, config.text_segmenter)


def check_models(config: ModelConfig) -> None:
    """Refuse names that are not known, without loading anything.

    Raises:
        ConfigError: listing the names that are.
    """
    if config.segmenter not in (*SEGMENTERS, ORACLE):
        raise unknown_name("segmenter", config.segmenter, [*SEGMENTERS, ORACLE])
    if config.text_segmenter not in (*TEXT_SEGMENTERS, ORACLE):
        raise unknown_name("text segmenter", config.text_segmenter, [*TEXT_SEGMENTERS, ORACLE])
    if config.encoder not in (*ENCODERS, ORACLE) and _random(config.encoder) is None:
        raise unknown_name("encoder", config.encoder, [*ENCODERS, ORACLE, "random:SEED"])


def build_models(config: ModelConfig | None = None, world: OracleWorld | None = None) -> Models:
    """The models of a configuration. Weights are loaded once a process and then shared.

    Args:
        config: Names and settings; the onboard models where none is given.
        world: The truth of the scene, where a model is an oracle.

    Raises:
        ConfigError: for a name that is not known, listing those that are, or an oracle without
            a truth.
        ModelError: for weights that are missing or wrong.
    """
    config = config or ModelConfig()
    check_models(config)
    if needs_world(config) and world is None:
        raise ConfigError(
            "oracle models need to know the truth", accepted="a scene whose Gaussians are labelled"
        )
    with _LOADING:
        segmenter = _segmenter(config, world)
        encoder = _encoder(config, world)
        return Models(segmenter, encoder, _text_segmenter(config, world, segmenter, encoder))


def _segmenter(config: ModelConfig, world: OracleWorld | None) -> Segmenter:
    if world is not None and config.segmenter == ORACLE:
        return OracleSegmenter(world)
    return SEGMENTERS[config.segmenter](config)


def _encoder(config: ModelConfig, world: OracleWorld | None) -> Encoder:
    if world is not None and config.encoder == ORACLE:
        return OracleEncoder(world)
    return _random(config.encoder) or ENCODERS[config.encoder](config)


def _text_segmenter(
    config: ModelConfig, world: OracleWorld | None, segmenter: Segmenter, encoder: Encoder
) -> TextSegmenter:
    if world is not None and config.text_segmenter == ORACLE:
        return OracleTextSegmenter(world)
    return TEXT_SEGMENTERS[config.text_segmenter](config, segmenter, encoder)
