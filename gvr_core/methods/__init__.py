"""Grounding methods behind one protocol, and the registry that names them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, JsonValue

from gvr_core import plugins
from gvr_core.errors import ConfigError, unknown_name
from gvr_core.method_names import METHODS
from gvr_core.methods.base import Grounding, Method
from gvr_core.methods.gvr_paper import GVRPaper, LocateConfig, SegmentConfig
from gvr_core.methods.gvr_robust import GVRRobust
from gvr_core.methods.lift import Lift, LiftConfig
from gvr_core.methods.predictions import Predictions, PredictionsConfig
from gvr_core.robust.config import (
    RobustConfig,
    RobustIndex,
    RobustLocate,
    RobustSegment,
)
from gvr_core.toolbox import Toolbox

PREDICTIONS = "predictions"
"""Name of the method that reads someone else's answers from a folder."""

OWN = (*METHODS, PREDICTIONS)
"""All names of the project's own; a plugin's method of such a name is never looked at."""

PARTS = ("name", "prepare", "index", "share", "ground", "locate", "segment")
"""What a plugin's method must have; see :class:`Method`."""

RANDOM_ENCODER = "random:0"
"""The control's encoder: unit vectors drawn from a seeded generator, blind to what they stand for.
It makes the retrieved patch of each view, and the proposal that a text mask picks, a random one."""


class MethodConfig(BaseModel):
    """Which method, under which name, with which switches."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: str = "gvr-paper"
    """A name from :data:`METHODS`, :data:`PREDICTIONS`, or a plugin's."""
    label: str = Field(default="", pattern=r"^[A-Za-z0-9 _./+-]{0,40}$")
    """Name in tables and MLflow; the method's own name where empty. What is left out of a variant
    comes on top."""
    leave_one_out: bool = False
    """Also run the method without each of its parts; see :func:`variants`."""
    locate: LocateConfig = LocateConfig()
    """``gvr-paper`` and ``random-patch``: retrieval for localising."""
    segment: SegmentConfig = SegmentConfig()
    """``gvr-paper`` and ``random-patch``: online segmentation."""
    robust: RobustConfig = RobustConfig()
    """``gvr-robust``: its switches."""
    lift: LiftConfig = LiftConfig()
    """``lift``: its settings."""
    predictions: PredictionsConfig = PredictionsConfig()
    """``predictions``: where they lie."""
    options: dict[str, JsonValue] = Field(default_factory=dict)
    """A plugin's method: what it is told."""

    @property
    def identity(self) -> str:
        """The method's own name; of a plugin's with its origin. Part of cache keys.

        Raises:
            PluginError: for a plugin that cannot be loaded.
        """
        if self.method in OWN:
            return self.method
        return f"{self.method} [{plugins.load(plugins.METHODS, self.method).origin}]"

    @property
    def shown_name(self) -> str:
        """The label, or the method's own name."""
        return self.label or self.method

    @property
    def encoder_override(self) -> str | None:
        """The encoder that the method itself demands, if any."""
        return RANDOM_ENCODER if self.method == "random-patch" else None

    @property
    def needs_books(self) -> bool:
        """Whether views have to be rendered, segmented and encoded for it."""
        return self.method != PREDICTIONS

    @property
    def background(self) -> tuple[float, float, float]:
        """Colour behind the renders of the knowledge views."""
        return self.segment.background

    def settings(self) -> dict[str, Any]:
        """What each step of the method depends on, as JSON values; goes into cache keys.

        Settings of other methods are left out: they change nothing.
        """
        index: dict[str, Any] = {}
        if self.method == "gvr-robust":
            index = _part(self.robust, RobustIndex)
            locate = _part(self.robust, RobustLocate)
            segment = _part(self.robust, RobustSegment)
        elif self.method == "lift":
            locate = {}
            segment = self.lift.model_dump(mode="json")
        elif self.method == PREDICTIONS:
            locate = {}
            segment = {"sha256": self.predictions.digest()}
        elif self.method not in OWN:
            index = locate = segment = self.options
        else:
            locate = self.locate.model_dump(mode="json")
            segment = self.segment.model_dump(mode="json") | {"rfl": self.locate.rfl}
        return {
            "background": list(self.background),
            "index": index,
            "locate": locate,
            "segment": segment,
        }


def variants(config: MethodConfig) -> tuple[MethodConfig, ...]:
    """A method, and where its configuration says so, the same without each of its parts.

    Returns:
        The configuration itself, then one for each part left out: the paper's own ablations, or
        one for each switch of ``gvr-robust`` that is on.
    """
    base = config.model_copy(update={"leave_one_out": False})
    if not config.leave_one_out:
        return (base,)
    parts: list[tuple[str, dict[str, Any]]] = []
    if config.method == "gvr-robust":
        parts = [
            (
                f"w/o {name.replace('_', ' ')}",
                {"robust": base.robust.model_copy(update={name: False})},
            )
            for name in base.robust.switches()
        ]
    elif config.method in ("gvr-paper", "random-patch"):
        no_rfl: dict[str, Any] = {"locate": base.locate.model_copy(update={"rfl": False})}
        no_smfi: dict[str, Any] = {"segment": base.segment.model_copy(update={"smfi": False})}
        parts = [("w/o RFL", no_rfl), ("w/o SMFI", no_smfi), ("w/o RFL and SMFI", no_rfl | no_smfi)]
    prefix = f"{config.label} " if config.label else ""
    return base, *(base.model_copy(update=part | {"label": prefix + name}) for name, part in parts)


def check_method(name: str, asked: bool = False, others: Sequence[str] = ()) -> None:
    """Refuse a name that is not registered, and a plugin that cannot be loaded.

    Args:
        name: The name.
        asked: Whether the method is to answer questions that nobody has asked before.
        others: Names of other things that could have been meant; errors list them too.

    Raises:
        ConfigError: listing the names that are.
        PluginError: for a plugin that cannot be loaded.
    """
    own = tuple(METHODS) if asked else OWN
    if name in own:
        return
    if name in OWN or not plugins.is_offered(plugins.METHODS, name):
        raise unknown_name("method", name, [*others, *own, *plugins.offered(plugins.METHODS)])
    plugins.load(plugins.METHODS, name)


def check_options(config: MethodConfig) -> None:
    """Refuse options that the method would not read.

    Raises:
        ConfigError: for options of a method of the project's own, which has tables instead.
    """
    if config.options and config.method in OWN:
        raise ConfigError(
            f"options of {config.method}",
            place="options",
            accepted="options of a plugin's method; those of the project's own are in tables "
            "such as locate, segment, robust, lift and predictions",
        )


def build_method(config: MethodConfig, tools: Toolbox) -> Method:
    """The method of that configuration.

    Raises:
        ConfigError: for a name that is not registered.
        PluginError: for a plugin that cannot be loaded, or does not take its options.
    """
    check_method(config.method)
    if config.method not in OWN:
        plugin = plugins.load(plugins.METHODS, config.method)
        made: Method = plugin.made(PARTS, tools, config.shown_name, **config.options)
        return made
    makers: dict[str, Callable[[], Method]] = {
        "gvr-robust": lambda: GVRRobust(tools, config.robust, config.background, config.shown_name),
        PREDICTIONS: lambda: Predictions(config.predictions, config.shown_name),
        "lift": lambda: Lift(tools, config.lift, config.background, config.shown_name),
    }
    if config.method in makers:
        return makers[config.method]()
    return GVRPaper(tools, config.locate, config.segment, config.shown_name)


def _part(config: RobustConfig, part: type[BaseModel]) -> dict[str, Any]:
    """The settings that one step reads."""
    return config.model_dump(mode="json", include=set(part.model_fields))


__all__ = [
    "METHODS",
    "PREDICTIONS",
    "Grounding",
    "Method",
    "MethodConfig",
    "Toolbox",
    "build_method",
    "check_method",
    "check_options",
    "variants",
]
