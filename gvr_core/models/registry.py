"""From names in a configuration to models."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from threading import RLock
from typing import Any, Generic, TypeVar, cast

from pydantic import BaseModel, ConfigDict, Field, JsonValue

from gvr_core import plugins
from gvr_core.errors import ConfigError, unknown_name
from gvr_core.models import full_strength
from gvr_core.models.base import Encoder, Models, Segmenter, TextSegmenter
from gvr_core.models.conse import ConseEncoder, ConseSettings
from gvr_core.models.devices import DeviceChoice
from gvr_core.models.graph_segmenter import GraphSegmenter, GraphSettings
from gvr_core.models.grounding_dino_config import GroundingDinoSettings
from gvr_core.models.open_clip_encoder import OpenClipSettings
from gvr_core.models.oracle import (
    OracleEncoder,
    OracleSegmenter,
    OracleTextSegmenter,
    OracleWorld,
)
from gvr_core.models.plugged import (
    ENCODER,
    SEGMENTER,
    TEXT_SEGMENTER,
    is_plugin,
    load_plugin,
    plugged,
)
from gvr_core.models.random_encoder import RandomEncoder
from gvr_core.models.ranked_proposals import RankedProposals, RankedSettings
from gvr_core.models.sam_prompts import SamSettings, SparseSamSettings

MadeBy = TypeVar("MadeBy")

ORACLE = "oracle"
"""Name of the models that know the truth; they need a scene with 3D labels."""


class ModelConfig(BaseModel):
    """Which models a method works with, and their settings."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    segmenter: str = "onboard-graph"
    """Cuts pictures into patches: ``"onboard-graph"``, ``"sam:vit_h"``, ``"sam-onnx:FOLDER"``;
    ``"oracle"`` knows the truth."""
    encoder: str = "onboard-conse"
    """Puts patches and texts into one space: ``"onboard-conse"``,
    ``"open_clip:ViT-B-16/laion2b_s34b_b88k"``; ``"random:SEED"`` is the control, ``"oracle"``
    knows the truth."""
    text_segmenter: str = "onboard-ranked"
    """Text -> mask in one picture: ``"onboard-ranked"``, ``"grounded_sam:swin_b"``; ``"oracle"``
    knows the truth."""
    device: DeviceChoice = "auto"
    """Where networks of full strength compute; the onboard models use the processor."""
    graph: GraphSettings = GraphSettings()
    """Settings of ``"onboard-graph"``."""
    conse: ConseSettings = ConseSettings()
    """Settings of ``"onboard-conse"``."""
    ranked: RankedSettings = RankedSettings()
    """Settings of ``"onboard-ranked"``."""
    sam: SamSettings = SamSettings()
    """Settings of ``"sam:..."``."""
    sam_onnx: SparseSamSettings = SparseSamSettings()
    """Settings of ``"sam-onnx:..."``."""
    open_clip: OpenClipSettings = OpenClipSettings()
    """Settings of ``"open_clip:..."``."""
    grounding_dino: GroundingDinoSettings = GroundingDinoSettings()
    """Settings of ``"grounded_sam:..."``."""
    options: dict[str, dict[str, JsonValue]] = Field(default_factory=dict)
    """Name of a plugin's model -> what it is told."""


@dataclass(frozen=True)
class Kind(Generic[MadeBy]):
    """Models whose names are of one form."""

    form: str
    """How a name is written, as errors show it."""
    pattern: str
    """Regular expression of the whole name; its group, if it has one, goes to ``make``."""
    make: MadeBy
    """Makes the model from the configuration and the group."""

    def rest(self, name: str) -> str | None:
        """What a name says after its prefix; None for a name of another form."""
        match = re.fullmatch(self.pattern, name)
        return None if match is None else "".join(match.groups())


SegmenterKind = Kind[Callable[["ModelConfig", str], Segmenter]]
EncoderKind = Kind[Callable[["ModelConfig", str], Encoder]]
TextSegmenterKind = Kind[Callable[["ModelConfig", str, Segmenter, Encoder], TextSegmenter]]

# One model for each of its settings, so that lines of a suite share what it has loaded and seen.


@lru_cache(maxsize=4)
def _graph_segmenter(settings: GraphSettings) -> Segmenter:
    return GraphSegmenter(settings)


@lru_cache(maxsize=4)
def _conse_encoder(settings: ConseSettings) -> Encoder:
    return ConseEncoder(settings)


@lru_cache(maxsize=4)
def _ranked_proposals(
    segmenter: Segmenter, encoder: Encoder, settings: RankedSettings
) -> TextSegmenter:
    return RankedProposals(segmenter, encoder, settings)


def _ranked(
    config: ModelConfig, rest: str, segmenter: Segmenter, encoder: Encoder
) -> TextSegmenter:
    # mypy cannot see that models are hashable, as all objects without an __eq__ are
    return _ranked_proposals(segmenter, encoder, config.ranked)  # type: ignore[arg-type]


SEGMENTERS: tuple[SegmenterKind, ...] = (
    Kind("onboard-graph", "onboard-graph", lambda c, _: _graph_segmenter(c.graph)),
    Kind(
        "sam:vit_h (or vit_l, vit_b, a checkpoint's path)",
        r"sam:(.+)",
        lambda c, rest: full_strength.sam(rest, c.sam, c.device),
    ),
    Kind(
        "sam-onnx:FOLDER",
        r"sam-onnx:(.+)",
        lambda c, rest: full_strength.sam_onnx(rest, c.sam_onnx),
    ),
)
"""Segmenters by the form of their names; the oracle comes on top."""

ENCODERS: tuple[EncoderKind, ...] = (
    Kind("onboard-conse", "onboard-conse", lambda c, _: _conse_encoder(c.conse)),
    Kind(
        "open_clip:MODEL/TAG",
        r"open_clip:(.+/[^/]+)",
        lambda c, rest: full_strength.open_clip(rest, c.open_clip, c.device),
    ),
    Kind("random:SEED", r"random:(\d{1,18})", lambda _, rest: RandomEncoder(int(rest))),
)
"""Encoders by the form of their names; the oracle comes on top."""

TEXT_SEGMENTERS: tuple[TextSegmenterKind, ...] = (
    Kind("onboard-ranked", "onboard-ranked", _ranked),
    Kind(
        "grounded_sam:swin_b (or swin_t)",
        r"grounded_sam:(swin_[bt])",
        lambda c, rest, segmenter, _: full_strength.grounded_sam(
            rest, c.grounding_dino, c.device, segmenter
        ),
    ),
)
"""Text segmenters by the form of their names, made with the other two models; the oracle comes
on top."""

_LOADING = RLock()
"""Two threads that want the same model wait for one loading."""


def needs_world(config: ModelConfig) -> bool:
    """Whether one of the models is an oracle, which has to be told the truth."""
    return ORACLE in (config.segmenter, config.encoder, config.text_segmenter)


def check_models(config: ModelConfig) -> None:
    """Refuse names that are not known, without looking at any file of weights.

    Raises:
        ConfigError: listing the names that are; for options of a model that is not chosen.
        PluginError: for a plugin that cannot be loaded.
    """
    roles: list[tuple[str, str, Sequence[Kind[Any]]]] = [
        ("segmenter", config.segmenter, SEGMENTERS),
        ("encoder", config.encoder, ENCODERS),
        ("text segmenter", config.text_segmenter, TEXT_SEGMENTERS),
    ]
    for role, name, kinds in roles:
        if _is_own(name, kinds):
            continue
        if not is_plugin(name):
            offered = plugins.offered(plugins.MODELS)
            raise unknown_name(role, name, [ORACLE, *(kind.form for kind in kinds), *offered])
        load_plugin(name)
    chosen = {name for _, name, kinds in roles if not _is_own(name, kinds)}
    unread = sorted(set(config.options) - chosen)
    if unread:
        raise ConfigError(
            f"options of {', '.join(unread)}",
            accepted=", ".join(sorted(chosen)) or "no options: no model is a plugin's",
        )


def is_own_name(name: str) -> bool:
    """Whether a name is one of the project's own models, in any role."""
    return any(_is_own(name, kinds) for kinds in (SEGMENTERS, ENCODERS, TEXT_SEGMENTERS))


def _is_own(name: str, kinds: Sequence[Kind[Any]]) -> bool:
    return name == ORACLE or any(kind.rest(name) is not None for kind in kinds)


def build_models(config: ModelConfig | None = None, world: OracleWorld | None = None) -> Models:
    """The models of a configuration, made once a process and then shared.

    Files of weights are looked for and their digests taken; they are loaded when a model is
    first asked something. So a run whose stages are all cached needs no more than the digests.

    Args:
        config: Names and settings; the onboard models where none is given.
        world: The truth of the scene, where a model is an oracle.

    Raises:
        ConfigError: for a name that is not known, listing those that are, an oracle without a
            truth, or a device that is not there.
        PluginError: for a plugin that cannot be loaded, or does not take its options.
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


def require_weights(config: ModelConfig) -> None:
    """Refuse models whose weights are not there, before anything else is done.

    Raises:
        ConfigError: as :func:`build_models`.
        ModelError: naming the file that is missing or wrong, and how to get it.
    """
    roles = ("segmenter", "encoder", "text_segmenter")
    known = {role: ModelConfig.model_fields[role].default for role in roles}
    oracles = {role: known[role] for role in roles if getattr(config, role) == ORACLE}
    build_models(config.model_copy(update=oracles))


def _segmenter(config: ModelConfig, world: OracleWorld | None) -> Segmenter:
    if world is not None and config.segmenter == ORACLE:
        return OracleSegmenter(world)
    if not _is_own(config.segmenter, SEGMENTERS):
        return cast(Segmenter, plugged(config.segmenter, SEGMENTER, config.options))
    make, rest = _kind_of(config.segmenter, SEGMENTERS)
    return make(config, rest)


def _encoder(config: ModelConfig, world: OracleWorld | None) -> Encoder:
    if world is not None and config.encoder == ORACLE:
        return OracleEncoder(world)
    if not _is_own(config.encoder, ENCODERS):
        return cast(Encoder, plugged(config.encoder, ENCODER, config.options))
    make, rest = _kind_of(config.encoder, ENCODERS)
    return make(config, rest)


def _text_segmenter(
    config: ModelConfig, world: OracleWorld | None, segmenter: Segmenter, encoder: Encoder
) -> TextSegmenter:
    if world is not None and config.text_segmenter == ORACLE:
        return OracleTextSegmenter(world)
    name = config.text_segmenter
    if not _is_own(name, TEXT_SEGMENTERS):
        made = plugged(name, TEXT_SEGMENTER, config.options, segmenter, encoder)
        return cast(TextSegmenter, made)
    make, rest = _kind_of(name, TEXT_SEGMENTERS)
    return make(config, rest, segmenter, encoder)


def _kind_of(name: str, kinds: Sequence[Kind[MadeBy]]) -> tuple[MadeBy, str]:
    """What makes the model of a name, and what the name says after its prefix."""
    return next((k.make, rest) for k in kinds if (rest := k.rest(name)) is not None)
