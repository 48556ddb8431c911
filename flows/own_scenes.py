"""What a folder of one's own scenes holds, and what of it a suite can run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from datasets.base import Dataset
from datasets.captures import CAPTURES, capture_folders
from datasets.lerf_mask import LERF_MASK
from datasets.lerf_mask import MASKS as LERF_MASKS
from datasets.ovs3d import MASKS as OVS3D_MASKS
from datasets.ovs3d import OVS3D
from datasets.recognise import CAPTURE, NATIVE, Recognised, recognise
from datasets.registry import FOLDER, get_dataset
from gvr_core.errors import DatasetError, InputError, some_of

MARKS = {LERF_MASK: LERF_MASKS, OVS3D: OVS3D_MASKS}
"""Layout -> the folder of masks that makes a folder one of its scenes."""


@dataclass(frozen=True)
class FoundScene:
    """A scene that was read."""

    name: str
    n_gaussians: int
    n_views: int
    n_queries: int
    """Those that it brings along; a capture brings none."""


@dataclass(frozen=True)
class LeftOut:
    """A scene that cannot be run."""

    name: str
    why: str


@dataclass(frozen=True)
class FoundData:
    """Scenes of one layout, as a suite names them."""

    layout: str
    """``native``, ``capture``, ``lerf_ovs``, ``lerf_mask`` or ``ovs3d``."""
    dataset: str
    """Name of the data set."""
    root: str | None
    """The data set's setting ``root``; None where its name holds the folder."""
    scenes: tuple[FoundScene, ...]
    left_out: tuple[LeftOut, ...]
    every: bool
    """Whether these are all scenes that the data set has."""


def look_at(folder: Path) -> tuple[FoundData, ...]:
    """Read every scene of a folder, as a run would.

    Args:
        folder: A folder of scenes, of one layout or of several, or a single scene.

    Returns:
        One for each layout. A scene in two layouts stands in both, since each has its own truth;
        a capture is what stands in none of the others.

    Raises:
        DatasetError: if nothing in it is a scene, or none can be run.
    """
    folder = folder.resolve()
    found = []
    for item in dict.fromkeys(recognise(folder)):
        if item.layout != CAPTURE:
            found.append(_read_labelled(item))
    taken = {scene.name for data in found for scene in data.scenes}
    taken |= {scene.name for data in found for scene in data.left_out}
    bare = [name for name in capture_folders(folder) if name not in taken]
    if bare:
        name = f"{CAPTURES}{folder}"
        found.append(_read(CAPTURE, name, None, get_dataset(name, {}), bare))
    if not any(data.scenes for data in found):
        left = [f"{scene.name}: {scene.why}" for data in found for scene in data.left_out]
        raise DatasetError(
            f"none of its scenes can be run: {some_of(left)}",
            path=folder,
            accepted="what `gvr datasets check` reads without an error",
        )
    return tuple(found)


def _read_labelled(item: Recognised) -> FoundData:
    """The scenes of a layout with truth."""
    root = item.root.resolve()
    if item.layout == NATIVE:
        name = f"{FOLDER}{root}"
        return _read(NATIVE, name, None, get_dataset(name, {}))
    dataset = get_dataset(item.layout, {"root": str(root)})
    wanted = [item.scene] if item.scene is not None else list(dataset.scenes())
    mark = MARKS.get(item.layout)
    if mark is not None and item.scene is None:
        # Scenes that papers report are listed without masks too; here those are captures.
        wanted = [scene for scene in wanted if (root / scene / mark).is_dir()]
    return _read(item.layout, item.layout, str(root), dataset, wanted)


def _read(
    layout: str,
    name: str,
    root: str | None,
    dataset: Dataset,
    wanted: Sequence[str] | None = None,
) -> FoundData:
    known = list(dataset.scenes())
    read = list(_scenes(dataset, known if wanted is None else wanted))
    scenes = tuple(item for item in read if isinstance(item, FoundScene))
    left_out = tuple(item for item in read if isinstance(item, LeftOut))
    return FoundData(layout, name, root, scenes, left_out, len(scenes) == len(known))


def _scenes(dataset: Dataset, names: Sequence[str]) -> Iterator[FoundScene | LeftOut]:
    for name in names:
        try:
            data = dataset.load(name)
        except InputError as error:
            yield LeftOut(name, str(error))
        else:
            scene = data.scene
            yield FoundScene(name, len(scene.gaussians), len(scene.views), len(data.queries))
