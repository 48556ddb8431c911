"""How encoders are read: by the first part of their names."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from gvr_core.models.registry import ENCODERS, ModelConfig, build_models
from gvr_core.robust.calibration import CALIBRATED, UNCALIBRATED, Calibration, calibration_of


@pytest.mark.parametrize("name", sorted(CALIBRATED))
def test_version_and_settings_do_not_matter(name: str) -> None:
    assert calibration_of(name) == CALIBRATED[name]
    assert calibration_of(f"{name}/7(crops=masked,a/b@1234)") == CALIBRATED[name]
    assert calibration_of(f"{name}-large/1") == UNCALIBRATED
    assert calibration_of(f"my/{name}/1") == UNCALIBRATED


@pytest.mark.parametrize("name", ["", "random/1(seed=0,dim=384)", "oracle/1(abc)", "open-clip/2"])
def test_what_nobody_has_calibrated_is_read_like_clip(name: str) -> None:
    found = calibration_of(name)
    assert found == UNCALIBRATED
    assert found.phrases and 0.5 < found.refuse_below < 1


def test_calibrated_encoders_are_ones_that_there_are() -> None:
    assert set(CALIBRATED) <= {kind.form for kind in ENCODERS}
    encoder = build_models(ModelConfig(encoder="onboard-conse")).encoder
    assert calibration_of(encoder.name) is CALIBRATED["onboard-conse"]


def test_it_cannot_be_changed_or_misspelt() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        UNCALIBRATED.refuse_below = 0.0
    with pytest.raises(ValidationError, match="phrase"):
        Calibration.model_validate({"phrase": True, "refuse_below": 0.5})
