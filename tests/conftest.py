"""Fixtures that every test folder shares."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with real splats, photographs and a small SAM; tests skip where it is absent."""
    folder = Path(os.environ.get("GVR_SHARED", REPOSITORY.parent / "shared"))
    if not (folder / "data" / "splats").is_dir():
        pytest.skip(f"no shared data at {folder} (set GVR_SHARED)")
    return folder
