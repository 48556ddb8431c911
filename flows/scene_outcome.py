"""What one line on one scene gave, and who is told of it."""

from __future__ import annotations

import logging
from typing import Any, Protocol, runtime_checkable

from pydantic import BaseModel, ConfigDict, Field

from flows.lines import Line
from gvr_core.errors import GVRError, InputError
from reports.record import Row, SceneResult
from tasks.store import Artifact

log = logging.getLogger(__name__)


class SceneOutcome(BaseModel):
    """What one line on one scene gave: its result, its rows, and its pictures in the store."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    result: SceneResult
    rows: tuple[Row, ...] = ()
    pictures: dict[str, Artifact] = Field(default_factory=dict)
    """Path relative to the result's folder -> the picture in the store."""
    bad_input: bool = False
    """Whether it failed for something the user gave."""

    @property
    def failed(self) -> bool:
        """Whether it failed, for whatever reason."""
        return self.result.status == "failed"


@runtime_checkable  # Prefect checks a flow's parameters for their kinds
class Listener(Protocol):
    """Is told how the lines of a scene go on, while they do."""

    def begun(self, line: str) -> None:
        """A line begins."""
        ...

    def ended(self, outcome: SceneOutcome) -> None:
        """A line has ended, well or not."""
        ...


class Notes:
    """A listener that remembers."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        """Those that have begun."""
        self.outcomes: list[SceneOutcome] = []
        """Of those that have ended."""

    def begun(self, line: str) -> None:
        """A line begins."""
        self.lines.append(line)

    def ended(self, outcome: SceneOutcome) -> None:
        """A line has ended, well or not."""
        self.outcomes.append(outcome)


def identity(dataset: str, scene: str, line: Line) -> dict[str, Any]:
    """Which scene and which line a result is of."""
    return {
        "dataset": dataset,
        "scene": scene,
        "method": line.name,
        "label": line.label,
        "model_set": line.model_set,
        "reference": line.reference,
    }


def failed_outcome(dataset: str, scene: str, line: Line, error: Exception) -> SceneOutcome:
    """The outcome of a line that ended with an error."""
    if not isinstance(error, GVRError):  # a mistake of ours, or a machine's: show where
        log.error("%s/%s · %s failed", dataset, scene, line.name, exc_info=error)
    text = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
    result = SceneResult(**identity(dataset, scene, line), status="failed", error=text)
    return SceneOutcome(result=result, bad_input=isinstance(error, InputError))
