"""Telemetry is off unless switched on, and the switch takes nothing but on and off."""

from __future__ import annotations

import pytest

from gvr_core.errors import ConfigError
from reports.mlflow_store import quiet_environment
from reports.telemetry import telemetry_allowed, telemetry_variables

OFF = {
    "DO_NOT_TRACK": "1",
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
}


@pytest.mark.parametrize("given", [None, "off"])
def test_off_unless_switched_on(given: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GVR_TELEMETRY", raising=False)
    if given is not None:
        monkeypatch.setenv("GVR_TELEMETRY", given)
    assert not telemetry_allowed()
    assert telemetry_variables() == OFF
    assert quiet_environment().items() >= OFF.items()


def test_on_leaves_the_variables_to_the_user(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in OFF:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("GVR_TELEMETRY", "on")
    assert telemetry_allowed()
    assert telemetry_variables() == {}
    assert not quiet_environment().keys() & OFF.keys()


@pytest.mark.parametrize("given", ["", "yes", "ON"])
def test_nothing_but_on_and_off(given: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GVR_TELEMETRY", given)
    with pytest.raises(ConfigError, match="on or off"):
        telemetry_variables()
