"""Models that other installed packages bring, made once a process like the project's own."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from pydantic import JsonValue

from gvr_core import plugins
from gvr_core.models.base import Encoder, Segmenter

SEGMENTER = ("name", "automatic", "at_point", "in_box")
"""What a plugin's segmenter must have, as the next two for their protocols."""
ENCODER = ("name", "dim", "encode_patches", "encode_texts")
TEXT_SEGMENTER = ("name", "segment")


def is_plugin(name: str) -> bool:
    """Whether an installed package offers a model of that name; nothing is loaded."""
    return plugins.is_offered(plugins.MODELS, name)


def load_plugin(name: str) -> None:
    """Import the plugin of a model.

    Raises:
        ConfigError: if several packages offer it.
        PluginError: if it cannot be imported.
    """
    plugins.load(plugins.MODELS, name)


def plugged(
    name: str,
    needed: tuple[str, ...],
    options: Mapping[str, Mapping[str, JsonValue]],
    *models: Segmenter | Encoder,
) -> Any:
    """The model of a plugin; the same one for the same options and models.

    Args:
        name: What the plugin offers it under.
        needed: What it must have to play its role.
        options: Plugin's name -> what it is told.
        models: What it is made with.

    Raises:
        PluginError: if it cannot be loaded, does not take its options, or lacks a part.
    """
    told = json.dumps(options.get(name, {}), sort_keys=True)
    # mypy cannot see that models are hashable, as all objects without an __eq__ are
    return _made(name, needed, told, *models)  # type: ignore[arg-type]


@lru_cache(maxsize=8)
def _made(name: str, needed: tuple[str, ...], told: str, *models: Segmenter | Encoder) -> Any:
    plugin = plugins.load(plugins.MODELS, name)
    origin = f"{plugin.origin}, {told}" if told != "{}" else plugin.origin
    return plugins.Known(plugin.made(needed, *models, **json.loads(told)), origin)
