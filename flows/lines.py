"""Lines: a benchmark's rows of figures, each one method with one set of models."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import Field

from gvr_core.errors import ConfigError, unknown_name
from gvr_core.methods import MethodConfig, variants
from gvr_core.models.registry import ModelConfig

MOST_LETTERS = 100
"""Of a name that becomes part of a file's name."""

SEPARATOR = " · "
"""Stands between method and models in a line's name; no label may hold it."""


class ModelSet(ModelConfig):
    """Models under a name of their own."""

    label: str = Field(default="", pattern=r"^[A-Za-z0-9 _./+-]{0,64}$")
    """Name in tables and MLflow; needed where a suite has several sets."""


ORACLE = ModelSet(label="oracle", segmenter="oracle", encoder="oracle", text_segmenter="oracle")
ONBOARD = ModelSet(label="onboard")
MOBILE_SAM = ModelSet(label="mobile-sam", segmenter="sam-onnx:mobile_sam")
PAPER = ModelSet(
    label="paper",
    segmenter="sam:vit_h",
    encoder="open_clip:ViT-B-16/laion2b_s34b_b88k",
    text_segmenter="grounded_sam:swin_b",
)
BUNDLED = {models.label: models for models in (ORACLE, ONBOARD, MOBILE_SAM, PAPER)}
"""Sets that can be asked for by name whatever the suite has."""


def bundled_models(label: str) -> ModelConfig:
    """The models of a bundled set.

    Raises:
        ConfigError: for a label that no bundled set has.
    """
    if label not in BUNDLED:
        raise unknown_name("set of models", label, BUNDLED)
    return ModelConfig.model_validate(BUNDLED[label].model_dump(exclude={"label"}))


@dataclass(frozen=True)
class Line:
    """One method with one set of models."""

    name: str
    """Unique in the suite: label and model set, the latter where it has a label."""
    label: str
    """The method's name in tables, without the model set."""
    model_set: str
    """Label of the model set; empty where the suite has a single one without a label."""
    method: MethodConfig
    models: ModelConfig
    reference: str | None
    """Name of the line that this one is compared with."""
    is_variant: bool = False
    """Whether it is a method without one of its parts."""


def make_lines(methods: Sequence[MethodConfig], models: Sequence[ModelSet]) -> tuple[Line, ...]:
    """Every method, and its variants, with every model set.

    A variant is compared with the method it is a variant of; any other method with the first one.

    Args:
        methods: As a suite has them.
        models: As a suite has them.

    Returns:
        The lines of the first model set, then those of the second, and so on: in this order
        models and cached stages are used again.

    Raises:
        ConfigError: for two lines of one name, or with names that differ only in letters that
            file names cannot have.
    """
    lines = []
    for chosen in models:
        settings = ModelConfig.model_validate(chosen.model_dump(exclude={"label"}))

        def name(method: MethodConfig, label: str = chosen.label) -> str:
            return SEPARATOR.join(filter(None, (method.shown_name, label)))

        for i, method in enumerate(methods):
            if not method.needs_books:  # no models have a part in it, so one line is all
                if chosen is models[0]:
                    label = method.shown_name
                    lines.append(Line(label, label, "", method, settings, None))
                continue
            base, *ablated = variants(method)
            against = name(methods[0]) if i else None
            lines.append(Line(name(base), base.shown_name, chosen.label, base, settings, against))
            lines += [
                Line(name(v), v.shown_name, chosen.label, v, settings, name(base), is_variant=True)
                for v in ablated
            ]
    _refuse_doubles([line.name for line in lines])
    return tuple(lines)


def _refuse_doubles(names: Sequence[str]) -> None:
    by_file: dict[str, list[str]] = {}
    for name in names:
        by_file.setdefault(file_name(name), []).append(name)
    for alike in by_file.values():
        if len(alike) > 1:
            different = list(dict.fromkeys(alike))
            said = f"are called {alike[0]}" if len(different) == 1 else "cannot be told apart"
            what = "two methods" if len(different) == 1 else " and ".join(different)
            raise ConfigError(f"{what} {said}", accepted="a label of its own for each")


def file_name(name: str) -> str:
    """A name with everything but ASCII letters, digits, dots and dashes replaced.

    One that is long, or loses letters of other alphabets, ends with its digest: it stays its own.
    """
    safe = "".join(c if c.isascii() and (c.isalnum() or c in ".-") else "_" for c in name)
    if len(safe) > MOST_LETTERS or any(c.isalnum() and not c.isascii() for c in name):
        digest = hashlib.sha256(name.encode("utf-8", "surrogateescape")).hexdigest()[:8]
        safe = f"{safe[:MOST_LETTERS]}-{digest}"
    return safe.strip(".") or "_"
