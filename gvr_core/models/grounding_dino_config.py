"""What a Grounding DINO is built from: its settings, its variants, its configuration keys."""

from __future__ import annotations

import ast
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from gvr_core.errors import ConfigError, unknown_name
from gvr_core.models.checkpoints import installed_file
from gvr_core.untrusted import MAX_TOML_BYTES, parse_json, parse_toml, read_regular

PACKAGE = "groundingdino"
"""The library's package; it is installed as ``groundingdino-py``."""

VARIANTS = {
    "swin_b": "config/GroundingDINO_SwinB_cfg.py",
    "swin_t": "config/GroundingDINO_SwinT_OGC.py",
}
"""The published variants, and the library's own configuration file of each."""

BACKBONES = (
    "swin_T_224_1k",
    "swin_B_224_22k",
    "swin_B_384_22k",
    "swin_L_224_22k",
    "swin_L_384_22k",
)
"""Backbones that the library builds without a look-up; its ResNets would be downloaded."""

MEMORY_TRICKS = ("use_checkpoint", "use_transformer_ckpt")
"""Keys that save memory in training by computing twice; they change no result."""

Keep = Literal["best", "all"]
"""The mask of the most probable box, or the union of the masks of all that count."""


class GroundingDinoSettings(BaseModel):
    """Which weights Grounding DINO has, and which of its boxes count."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    checkpoint: Path | None = None
    """Weights of the whole detector, BERT's among them; None for the one in the models folder."""
    config: Path | None = None
    """A ``.json`` or ``.toml`` file whose keys go before those of the variant's own
    configuration; None for the variant as published."""
    bert: Path | None = None
    """Folder with BERT's ``config.json`` and tokenizer files; None for the one in the models
    folder. No weights are read from it."""
    box_threshold: float = Field(default=0.35, ge=0, le=1)
    """A box counts if its most probable token is above this."""
    text_threshold: float = Field(default=0.25, ge=0, le=1)
    """A token belongs to a box if its probability is above this; a box without one does not
    count, so it matters only where it is above the other threshold."""
    shorter_side: int = Field(default=800, ge=32)
    """The picture's shorter side is resized to this, pixels."""
    longest_side: int = Field(default=1333, ge=32)
    """Unless its longer side would be above this, pixels."""
    keep: Keep = "best"
    """The mask of the most probable box, or the union of the masks of all that count."""

    @model_validator(mode="after")
    def _sides_in_order(self) -> Self:
        if self.longest_side < self.shorter_side:
            raise ValueError(
                f"longest_side {self.longest_side} is below shorter_side {self.shorter_side}"
            )
        return self


def check_variant(variant: str) -> None:
    """Refuse the name of a variant that is not known, without loading anything.

    Raises:
        ConfigError: listing those that are.
    """
    if variant not in VARIANTS:
        raise unknown_name("variant of Grounding DINO", variant, VARIANTS)


def configuration(variant: str, overrides: Path | None = None) -> dict[str, Any]:
    """The library's configuration keys of a variant.

    The library runs its configuration files as programs. Here they are parsed, and their
    constants are taken; nothing of them is run.

    Args:
        variant: A key of :data:`VARIANTS`.
        overrides: ``.json`` or ``.toml`` file whose keys go before the variant's.

    Returns:
        Key -> value. What saves memory in training only is switched off, and the name of a
        text encoder is left out.

    Raises:
        ConfigError: for an unknown variant, an override file of another kind, an unknown key or
            a value of another type, or a backbone that would have to be looked up.
        ModelError: if the library is not installed.
    """
    check_variant(variant)
    file = installed_file(PACKAGE, VARIANTS[variant])
    keys: dict[str, Any] = {}
    for statement in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name):
            keys[statement.targets[0].id] = ast.literal_eval(statement.value)
    if overrides is not None:
        own = _read(overrides)
        for key, value in own.items():
            _check(overrides, key, value, keys)
        keys.update(own)
    del keys["text_encoder_type"]  # the BERT folder takes its place
    keys.update(dict.fromkeys(MEMORY_TRICKS, False))
    return keys


def _read(path: Path) -> dict[str, Any]:
    kinds = "a .json or .toml file of the library's configuration keys"
    readers: dict[str, Callable[[str], Any]] = {".json": parse_json, ".toml": parse_toml}
    if path.suffix.lower() not in readers:
        reason = (
            "reading a .py file would run it"
            if path.suffix.lower() == ".py"
            else "its kind is unknown"
        )
        raise ConfigError(f"cannot be used: {reason}", path=path, accepted=kinds)
    try:
        keys = readers[path.suffix.lower()](read_regular(path, MAX_TOML_BYTES).decode("utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", path=path, accepted=kinds) from error
    except ValueError as error:
        raise ConfigError(f"cannot be parsed: {error}", path=path, accepted=kinds) from error
    if not isinstance(keys, dict):
        raise ConfigError(f"holds a {type(keys).__name__}", path=path, accepted=kinds)
    return keys


def _check(path: Path, key: str, value: object, known: dict[str, Any]) -> None:
    """Refuse a key or a value that the library has no use for."""
    place = f"key {key!r}"
    if key not in known:
        raise ConfigError("unknown", path=path, place=place, accepted=", ".join(sorted(known)))
    usual = known[key]
    fits = type(value) is type(usual) or (isinstance(usual, float) and type(value) is int)
    if usual is not None and not fits:
        raise ConfigError(
            f"{value!r} is of type {type(value).__name__}",
            path=path,
            place=place,
            accepted=f"a {type(usual).__name__}, e.g. {usual!r}",
        )
    allowed = {"backbone": BACKBONES, "modelname": (known["modelname"],)}.get(key)
    if allowed is not None and value not in allowed:
        raise ConfigError(f"{value!r}", path=path, place=place, accepted=", ".join(allowed))
