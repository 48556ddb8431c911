"""Where the project keeps its files: everything under ``.gvr``, or where a variable says."""

from __future__ import annotations

import os
from pathlib import Path


def home() -> Path:
    """The project's folder for data, store, results and tracking: GVR_HOME, else ``.gvr``."""
    return Path(os.environ.get("GVR_HOME", ".gvr"))


def store_root() -> Path:
    """The artifact store: GVR_STORE, else ``store`` under the home."""
    return Path(os.environ.get("GVR_STORE", home() / "store"))


def results_root() -> Path:
    """The results: GVR_RESULTS, else ``results`` under the home."""
    return Path(os.environ.get("GVR_RESULTS", home() / "results"))
