"""Where the project keeps its files: everything under ``.gvr``, or where a variable says."""

from __future__ import annotations

import os
from pathlib import Path

from gvr_core.remote_url import is_url


def home() -> Path:
    """The project's folder for data, store, results and tracking: GVR_HOME, else ``.gvr``."""
    return Path(os.environ.get("GVR_HOME", ".gvr"))


def store_root() -> Path | str:
    """The artifact store: GVR_STORE (a folder, or the URL of a shared one), else ``store``."""
    return _place("GVR_STORE", "store")


def results_root() -> Path | str:
    """The results: GVR_RESULTS (a folder, or the URL of a shared one), else ``results``."""
    return _place("GVR_RESULTS", "results")


def _place(variable: str, name: str) -> Path | str:
    given = os.environ.get(variable)
    if given is None:
        return home() / name
    return given if is_url(given) else Path(given)
