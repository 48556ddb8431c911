"""The suites that come with the project, by name."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

DEFAULT_SUITE = "bench"


def bundled_suites() -> dict[str, Path]:
    """Name -> file."""
    folder = Path(str(resources.files("flows") / "suites"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}
