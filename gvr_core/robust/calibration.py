"""What had to be measured about an encoder before its relevancies can be read.

The scale of a similarity is the encoder's own. Where it was calibrated, that was done on scenes
that no figure is reported on; the command is named beside the numbers.
"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Calibration(BaseModel):
    """How to read an encoder."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    phrases: bool
    """Whether canonical phrases help to tell patches apart. In CLIP's space they do (LERF)."""
    refuse_below: float
    """Least confidence to answer: what 95 % of the queries for things that are there reach."""


UNCALIBRATED = Calibration(phrases=True, refuse_below=0.55)
"""Encoders that nobody has calibrated: a little more like the query than like any phrase."""

CALIBRATED = {"onboard-conse": Calibration(phrases=False, refuse_below=0.697)}
"""By the first part of the encoder's name. `python benchmarks/calibrate.py` on gallery scenes of
seeds 1000 to 1005, which no suite reports."""


def calibration_of(encoder_name: str, phrases: bool | None = None) -> Calibration:
    """How to read the encoder of that name.

    Args:
        encoder_name: The name with version and settings, e.g. ``"onboard-conse/1(...)"``.
        phrases: A setting that stands in for what was measured; None for what was.
    """
    known = CALIBRATED.get(encoder_name.split("/")[0], UNCALIBRATED)
    return known if phrases is None else known.model_copy(update={"phrases": phrases})
