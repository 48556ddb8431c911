"""Small packages with entry points, as pip leaves them: the modules, and a folder of metadata."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

from gvr_core import plugins
from gvr_core.models import plugged


def install(
    folder: Path,
    name: str,
    version: str,
    offers: Mapping[str, Mapping[str, str]],
    modules: Mapping[str, str],
) -> None:
    """Put a distribution into a folder, in place of another version of it.

    Args:
        folder: A folder of installed packages.
        name: The distribution's name.
        version: Its version.
        offers: Group -> name -> ``module:thing``.
        modules: Name of a file -> its text.
    """
    for old in folder.glob(f"{name}-*.dist-info"):
        shutil.rmtree(old)
    info = folder / f"{name}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    lines = []
    for group, points in offers.items():
        lines += [f"[{group}]", *(f"{offer} = {value}" for offer, value in points.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    for file, text in modules.items():
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def as_in_a_new_process(folder: Path) -> None:
    """Forget what was found and imported, as a process that starts now."""
    for cached in (plugins._entry_points, plugins.load, plugged._made):
        cached.cache_clear()
    plugins._LOADED.clear()
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", None) or "").startswith(str(folder)):
            del sys.modules[name]
