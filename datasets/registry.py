"""The data sets by name."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from datasets.base import Dataset, SceneData
from datasets.camera_checks import is_file
from datasets.captures import CAPTURES, CapturesDataset
from datasets.composite import COMPOSITE, LAYOUTS, STRESS, STRESS_LAYOUTS, CompositeDataset
from datasets.gallery import GalleryDataset
from datasets.lerf_mask import LERF_MASK, LerfMaskDataset
from datasets.lerf_ovs import NAME as LERF_OVS
from datasets.lerf_ovs import LerfOvsDataset
from datasets.native import read_scene
from datasets.ovs3d import OVS3D, Ovs3dDataset
from datasets.plugged import PluginDataset
from gvr_core import plugins
from gvr_core.errors import ConfigError, DatasetError, unknown_name
from gvr_core.untrusted import expanded

FOLDER = "folder:"
"""Names that begin with this are folders of scenes in the native layout."""


def data_root() -> Path:
    """Where made scenes are kept: GVR_DATA, else ``data`` under GVR_HOME, else ``.gvr/data``."""
    return Path(os.environ.get("GVR_DATA") or Path(os.environ.get("GVR_HOME", ".gvr")) / "data")


class FolderDataset:
    """Scenes in the native layout, as they lie in a folder.

    Args:
        folder: A folder of scenes, or a single scene.

    Raises:
        DatasetError: if there is no scene in it.
    """

    def __init__(self, folder: Path) -> None:
        self.name = FOLDER + str(folder)
        alone = is_file(folder / "scene.json")
        found = [folder.resolve()] if alone else _scene_folders(folder)
        if not found:
            raise DatasetError(
                "no scene here",
                path=folder,
                accepted="a folder that holds scene.json, or folders that do",
            )
        self._folders = {path.name: path for path in found}

    def scenes(self) -> Sequence[str]:
        """Names of the scenes' folders, in alphabetical order."""
        return tuple(self._folders)

    def load(self, scene: str) -> SceneData:
        """Read one scene.

        Raises:
            ConfigError: for a scene that is not in the folder.
            InputError: for files that are not as the layout says.
        """
        if scene not in self._folders:
            raise unknown_name("scene", scene, self._folders)
        return read_scene(self._folders[scene], self.name, scene)


def _scene_folders(folder: Path) -> list[Path]:
    """Folders with a scene, without the hidden ones that a killed writer may leave."""
    found = sorted(path.parent for path in folder.glob("*/scene.json"))
    return [path for path in found if not path.name.startswith(".")]


def _gallery(seeds: object = (0, 1, 2, 3)) -> Dataset:
    listed = list(seeds) if isinstance(seeds, (list, tuple)) else []
    if (
        not listed
        or len(set(listed)) < len(listed)
        or not all(type(seed) is int and 0 <= seed < 2**63 for seed in listed)
    ):
        raise ConfigError(
            f"seeds {seeds!r}"[:100],
            place="gallery.settings.seeds",
            accepted="a list of different whole numbers, 0 or larger",
        )
    return GalleryDataset(data_root() / "gallery", listed)


def _composed(name: str, layouts: Path) -> Callable[..., Dataset]:
    """How a data set of layouts is made."""

    def make(splats: object = None) -> Dataset:
        if splats is not None and not (isinstance(splats, str) and splats):
            raise ConfigError(
                f"splats {splats!r}"[:100],
                place=f"{name}.settings.splats",
                accepted="the path of a folder",
            )
        return CompositeDataset(data_root() / name, Path(splats) if splats else None, layouts, name)

    return make


def benchmark_root(name: str) -> Path | None:
    """Where a benchmark is looked for: under GVR_DATASETS; None where that is unset."""
    given = os.environ.get("GVR_DATASETS")
    return expanded(Path(given)) / name if given else None


def _captured(name: str, reader: Callable[[Path, Path | None], Dataset]) -> Callable[..., Dataset]:
    """How a benchmark of captures is made, in the layout that it is published in."""

    def make(root: object = None, splats: object = None) -> Dataset:
        for setting, value in (("root", root), ("splats", splats)):
            if value is not None and not (isinstance(value, str) and value):
                raise ConfigError(
                    f"{setting} {value!r}"[:100],
                    place=f"{name}.settings.{setting}",
                    accepted="the path of a folder",
                )
        folder = expanded(Path(str(root))) if root else benchmark_root(name)
        if folder is None:
            raise DatasetError(
                f"nobody said where {name} lies",
                accepted=f"GVR_DATASETS, with {name}/ in it, or the data set's setting root",
            )
        return reader(folder, expanded(Path(str(splats))) if splats else None)

    return make


CAPTURED: dict[str, Callable[[Path, Path | None], Dataset]] = {
    LERF_OVS: LerfOvsDataset,
    LERF_MASK: LerfMaskDataset,
    OVS3D: Ovs3dDataset,
}
"""Benchmarks of captures: name -> reader of a root and a folder of splats."""

DATASETS: dict[str, tuple[Callable[..., Dataset], tuple[str, ...]]] = {
    "gallery": (_gallery, ("seeds",)),
    COMPOSITE: (_composed(COMPOSITE, LAYOUTS), ("splats",)),
    STRESS: (_composed(STRESS, STRESS_LAYOUTS), ("splats",)),
    **{name: (_captured(name, reader), ("root", "splats")) for name, reader in CAPTURED.items()},
}
"""Name -> how to make it, and the settings it takes."""


def check_dataset(name: str) -> None:
    """Refuse a name that is not registered, and a plugin that cannot be loaded.

    Raises:
        ConfigError: listing the names that are.
        PluginError: for a plugin that cannot be loaded.
    """
    if name in DATASETS or name.startswith((FOLDER, CAPTURES)):
        return
    if not plugins.is_offered(plugins.DATASETS, name):
        offered = plugins.offered(plugins.DATASETS)
        known = [*DATASETS, *offered, FOLDER + "PATH", CAPTURES + "PATH"]
        raise unknown_name("data set", name, known)
    plugins.load(plugins.DATASETS, name)


def get_dataset(name: str, settings: Mapping[str, Any]) -> Dataset:
    """The data set of that name.

    Args:
        name: A registered name, ``folder:PATH``, ``captures:PATH``, or the name of a plugin's.
        settings: What the data set can be told; see :data:`DATASETS`.

    Raises:
        ConfigError: for a name or a setting that is not known.
        DatasetError: for a folder without scenes.
        PluginError: for a plugin that cannot be loaded, or does not take its settings.
    """
    check_dataset(name)
    if name not in DATASETS and not name.startswith((FOLDER, CAPTURES)):
        return PluginDataset(plugins.load(plugins.DATASETS, name), settings)
    make, accepted = DATASETS.get(name) or _of_folder(name)
    unknown = sorted(set(settings) - set(accepted))
    if unknown:
        raise ConfigError(
            f"unknown setting {', '.join(unknown)} of the data set {name}",
            accepted=", ".join(accepted) or "no settings",
        )
    return make(**settings)


def _of_folder(name: str) -> tuple[Callable[..., Dataset], tuple[str, ...]]:
    """How the scenes of a folder of one's own are read, and the settings that takes."""
    if name.startswith(CAPTURES):
        return partial(CapturesDataset, Path(name.removeprefix(CAPTURES))), ("queries",)
    return partial(FolderDataset, Path(name.removeprefix(FOLDER))), ()
