"""Whether a folder in a published layout holds the published data, or an export of ours."""

from __future__ import annotations

import json
from collections.abc import Collection
from pathlib import Path

from datasets.base import SceneData
from gvr_core.atomic import atomic_write

MARKER = "exported.json"
"""Lies in the folder of a scene that was exported, and says of what."""


def mark_export(folder: Path, data: SceneData) -> None:
    """Say in a scene's folder that it was exported, and from which scene."""
    content = {"exported_from": f"{data.scene.dataset}/{data.scene.name}", "by": "gvr-bench"}
    with atomic_write(folder / MARKER) as stream:
        stream.write(json.dumps(content, indent=1).encode())


def is_original(folder: Path, published: Collection[str]) -> bool:
    """Whether a scene's folder is taken for the published data.

    It bears the name of a published scene, and no export of ours made it. Whether somebody else
    changed it cannot be known.
    """
    return folder.name in published and not (folder / MARKER).exists()
