"""What the writers of published layouts share: a trained scene as others keep it, and prompts."""

from __future__ import annotations

import shutil
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from datasets.base import SceneData
from datasets.colmap import write_colmap_text
from datasets.images import read_image
from datasets.native_records import MODEL, PLY, check_distinct, check_name
from gvr_core.atomic import atomic_write, sync_folder
from gvr_core.errors import DatasetError
from gvr_core.gaussians import SH_C0, Gaussians
from gvr_core.rendering.base import Renderer
from gvr_core.scene import View
from gvr_core.splat_io import write_ply

MAX_POINTS = 5000
"""Points of the COLMAP model: an even choice of the Gaussians' centres."""

JPEG_QUALITY = 95


@dataclass(frozen=True, eq=False)
class Shot:
    """A view, and the name that its picture gets."""

    stem: str
    view: View

    @property
    def file(self) -> str:
        """Name of the picture."""
        return f"{self.stem}.jpg"


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """A folder that takes its name once all of it is written, and is deleted if that fails.

    Raises:
        DatasetError: if there is something of that name.
        OSError: if it cannot be made.
    """
    if folder.exists():
        raise DatasetError("there is something already", path=folder, accepted="a new folder")
    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary = folder.parent / f".{folder.name}.{uuid.uuid4().hex}.tmp"
    try:
        temporary.mkdir()
        yield temporary
        temporary.rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    sync_folder(folder.parent)


def write_capture(
    folder: Path, gaussians: Gaussians, shots: Sequence[Shot], renderer: Renderer
) -> None:
    """A trained scene: ``images/``, ``sparse/0/`` as text, the splat in ``point_cloud/``.

    Args:
        folder: The scene's folder.
        gaussians: The splat.
        shots: All views; a view without a picture is rendered.
        renderer: Draws those.

    Raises:
        CameraFormatError: for a name that COLMAP cannot hold.
        DatasetError: for a picture that cannot be read.
        OSError: if a file cannot be written.
    """
    write_ply(folder / PLY, gaussians)
    chosen = np.unique(np.linspace(0, len(gaussians) - 1, MAX_POINTS).astype(int))
    colours = np.rint(255 * np.clip(0.5 + SH_C0 * gaussians.sh[chosen, 0], 0, 1))
    cameras = [(shot.file, shot.view.camera) for shot in shots]
    write_colmap_text(folder / MODEL, cameras, gaussians.means[chosen], colours.astype(np.uint8))
    for shot in shots:
        write_photograph(folder / "images" / shot.file, gaussians, shot.view, renderer)


def write_photograph(path: Path, gaussians: Gaussians, view: View, renderer: Renderer) -> None:
    """A view's picture as JPEG: its photograph where there is one, else a render.

    Raises:
        DatasetError: for a photograph that cannot be read, or is not as large as its camera says.
        OSError: if the file cannot be written.
    """
    size = (view.camera.width, view.camera.height)
    if view.image is not None:
        pixels = read_image(view.image, size=size)
    else:
        drawn = np.clip(renderer.render(gaussians, view.camera).rgb, 0, 1)
        pixels = np.rint(255 * drawn).astype(np.uint8)
    with atomic_write(path) as stream:
        # The evaluators look at labels alone, so what JPEG loses costs no protocol anything.
        Image.fromarray(pixels).save(stream, format="JPEG", quality=JPEG_QUALITY, subsampling=0)


def prompts(data: SceneData) -> dict[str, str]:
    """Object -> the one text that stands for it: its first query's, else its name.

    The published layouts know a prompt where this project has an object and its wordings. A text
    that cannot be a file name, or stands for another object, gives way to the next one.

    Raises:
        DatasetError: if an object has no text of its own that can be a file name.
    """
    path = Path(data.scene.name)
    chosen: dict[str, str] = {}
    for name in data.truth.objects:
        texts = [query.text for query in data.queries if query.target == name]
        for text in [*texts, name]:
            try:
                check_name(text, "prompt", path)
                check_distinct([*chosen.values(), text], "prompt", path)
            except DatasetError:
                continue
            chosen[name] = text
            break
        else:
            raise DatasetError(
                f"no text of {name!r} can be the name of its mask",
                path=path,
                accepted="a query for each object that no other object has, of file name letters",
            )
    return chosen
