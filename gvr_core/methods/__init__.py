"""Grounding methods behind one protocol, and the registry that names them."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from gvr_core.errors import unknown_name
from gvr_core.methods.base import Grounding, Method, Toolbox
from gvr_core.methods.gvr_paper import GVRPaper, LocateConfig, SegmentConfig

METHODS = {
    "gvr-paper": "the paper's method",
    "random-patch": "control: the paper's method with a random patch retrieved in each view",
}
"""Name -> one line on what it is."""

RANDOM_ENCODER = "random:0"
"""The control's encoder: unit vectors drawn from a seeded generator, blind to what they stand for.
It makes the retrieved patch of each view, and the proposal that a text mask picks, a random one."""


class MethodConfig(BaseModel):
    """Which method, under which name, with which switches."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: str = "gvr-paper"
    """A name from :data:`METHODS`."""
    label: str = Field(default="", pattern=r"^[A-Za-z0-9 _./+-]{0,64}$")
    """Name in tables and MLflow; the method's own name where empty."""
    locate: LocateConfig = LocateConfig()
    segment: SegmentConfig = SegmentConfig()

    @property
    def shown_name(self) -> str:
        """The label, or the method's own name."""
        return self.label or self.method

    @property
    def encoder_override(self) -> str | None:
        """The encoder that the method itself demands, if any."""
        return RANDOM_ENCODER if self.method == "random-patch" else None


def check_method(name: str) -> None:
    """Refuse a name that is not registered.

    Raises:
        ConfigError: listing the names that are.
    """
    if name not in METHODS:
        raise unknown_name("method", name, METHODS)


def build_method(config: MethodConfig, tools: Toolbox) -> Method:
    """The method of that configuration.

    Raises:
        ConfigError: for a name that is not registered.
    """
    check_method(config.method)
    return GVRPaper(tools, config.locate, config.segment, config.shown_name)


__all__ = [
    "METHODS",
    "Grounding",
    "Method",
    "MethodConfig",
    "Toolbox",
    "build_method",
    "check_method",
]
