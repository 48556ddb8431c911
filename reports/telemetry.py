"""Prefect and MLflow tell their makers nothing, unless the user says that they may."""

from __future__ import annotations

import os

from gvr_core.errors import ConfigError

SWITCH = "GVR_TELEMETRY"
"""Environment variable: ``on`` leaves telemetry to Prefect's and MLflow's own settings."""

_OFF = {
    "DO_NOT_TRACK": "1",
    "MLFLOW_DISABLE_TELEMETRY": "true",  # MLflow does not go by DO_NOT_TRACK alone
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
}


def telemetry_allowed() -> bool:
    """Whether the user has switched telemetry on.

    Raises:
        ConfigError: for a value of the switch that is neither ``on`` nor ``off``.
    """
    given = os.environ.get(SWITCH, "off")
    if given not in ("on", "off"):
        raise ConfigError(f"{SWITCH}={given}", accepted="on or off, which is the default")
    return given == "on"


def telemetry_variables() -> dict[str, str]:
    """Environment variables for this process and its children; none where telemetry is allowed.

    They have to be set before Prefect or MLflow is imported.

    Raises:
        ConfigError: for a value of the switch that is neither ``on`` nor ``off``.
    """
    return {} if telemetry_allowed() else dict(_OFF)
