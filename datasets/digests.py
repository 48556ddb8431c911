"""Digests of the parts of a scene, from which cache keys are made."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable

from gvr_core.atomic import file_digest
from gvr_core.scene import View


def view_parts(view: View, with_picture: bool) -> str:
    """What a view is, for a digest: name, camera and, if wanted, the picture's content."""
    camera = view.camera
    numbers = camera.K.tobytes() + camera.world_to_camera.tobytes()
    picture = file_digest(view.image) if with_picture and view.image else ""
    return f"{view.name} {camera.width} {camera.height} {numbers.hex()} {picture}"


def digest_of(parts: Iterable[str]) -> str:
    """sha256 of several texts; their lengths keep them apart."""
    total = hashlib.sha256()
    for part in parts:
        total.update(f"{len(part)}:{part}".encode())
    return total.hexdigest()
