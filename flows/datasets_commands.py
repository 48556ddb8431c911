"""What ``gvr datasets`` does; each function is one command, usable without a shell."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from datasets.cameras_file import has_cameras
from datasets.composite import splats_folder
from datasets.export_lerf_mask import export_lerf_mask
from datasets.export_lerf_ovs import export_lerf_ovs
from datasets.export_ovs3d import export_ovs3d
from datasets.lerf_mask import LERF_MASK
from datasets.lerf_ovs import NAME as LERF_OVS
from datasets.ovs3d import OVS3D
from datasets.recognise import EXPECTED
from datasets.registry import CAPTURED, DATASETS, benchmark_root, data_root, get_dataset
from datasets.splat_places import find_splat
from flows.output import print_document, say
from gvr_core.errors import InputError, unknown_name
from gvr_core.rendering import get_renderer

NOWHERE = "nowhere: GVR_DATASETS is not set"

VARIABLES = {
    "GVR_DATASETS": "benchmarks, each in a folder of its name",
    "GVR_DATA": "scenes that are made on first use",
    "GVR_HOME": "everything else of gvr; .gvr where unset",
    "GVR_SPLATS": "captured splats that scenes are composed of",
    "GVR_SHARED": "a folder whose data/splats is looked at where GVR_SPLATS is unset",
}
"""Variables that say where data lies, and what of it."""


@dataclass(frozen=True)
class Listed:
    """One data set that is known."""

    name: str
    root: str | None
    """Where it is looked for; None where nobody said."""
    made: bool
    """Whether its scenes are made here, in place of being found."""
    found: tuple[str, ...]
    """Scenes that can be asked for."""
    missing: tuple[str, ...]
    """What is not there: scenes that papers report, or a scene's splat, cameras or folder."""
    problem: str | None
    """Why nothing of it can be read."""


@dataclass(frozen=True)
class DatasetsDocument:
    """The data sets that are known."""

    datasets: tuple[Listed, ...]


@dataclass(frozen=True)
class Place:
    """A folder that is looked at."""

    path: Path | None
    there: bool
    problem: str | None
    """Why there is no such folder to look at."""


@dataclass(frozen=True)
class WhereDocument:
    """Which variables and folders are looked at."""

    variables: dict[str, str | None]
    places: dict[str, Place]


@dataclass(frozen=True)
class ExportDocument:
    """Layout -> the folder of the scene in it."""

    folders: dict[str, Path]


EXPORTS: dict[str, Callable[..., Path]] = {
    LERF_OVS: export_lerf_ovs,
    LERF_MASK: export_lerf_mask,
    OVS3D: export_ovs3d,
}
"""Layouts that scenes can be written in."""


def datasets_export(
    dataset: str, scene: str, layouts: Sequence[str], out: Path, as_json: bool = False
) -> None:
    """``gvr datasets export``: a scene with exact truth, in published layouts.

    Args:
        dataset: Name of the data set.
        scene: Name of the scene.
        layouts: Names of the layouts; all where none is given.
        out: Gets a folder for each layout, which may be given as GVR_DATASETS then.
        as_json: Print a document, in place of lines.

    Raises:
        ConfigError: for a name that is not known.
        DatasetError: for a scene that cannot be read, or has no room in a layout.
    """
    for layout in layouts:
        if layout not in EXPORTS:
            raise unknown_name("layout", layout, EXPORTS)
    data = get_dataset(dataset, {}).load(scene)
    folders = {}
    for layout in layouts or EXPORTS:
        folders[layout] = EXPORTS[layout](data, out / layout, get_renderer("numba"))
        if not as_json:
            say(str(folders[layout]))
    if as_json:
        print_document("datasets export", ExportDocument(folders))


def datasets_ls(as_json: bool) -> None:
    """``gvr datasets ls``.

    Args:
        as_json: Print a document with everything that is known, in place of lines.
    """
    listing = tuple(_listed(name) for name in DATASETS)
    if as_json:
        print_document("datasets ls", DatasetsDocument(listing))
        return
    for item in listing:
        state = " (made on first use)" if item.made else ""
        say(f"{item.name}  {item.root or NOWHERE}{state}")
        if item.problem is None:
            say(f"  scenes:  {names(item.found)}")
        elif item.root is not None:
            say(f"  problem: {item.problem}")
        if item.missing:
            say(f"  missing: {names(item.missing)}")


def datasets_where(as_json: bool = False) -> None:
    """``gvr datasets where``."""
    document = _places()
    if as_json:
        print_document("datasets where", document)
        return
    for variable, meaning in VARIABLES.items():
        say(f"{variable} = {document.variables[variable] or '(not set)'}  {meaning}")
    say("")
    for name, place in document.places.items():
        if place.path is None:
            say(f"{name}: {place.problem}")
        else:
            say(f"{name}: {place.path}{'' if place.there else ' (not there)'}")


def _places() -> WhereDocument:
    roots = {name: benchmark_root(name) for name in CAPTURED} | {"made scenes": data_root()}
    places = {
        name: Place(None, False, NOWHERE) if root is None else Place(root, root.is_dir(), None)
        for name, root in roots.items()
    }
    try:
        places["captured splats"] = Place(splats_folder(), True, None)
    except InputError as error:
        places["captured splats"] = Place(None, False, str(error))
    variables = {variable: os.environ.get(variable) or None for variable in VARIABLES}
    return WhereDocument(variables, places)


def _listed(name: str) -> Listed:
    """What is known of one data set."""
    root = benchmark_root(name) if name in CAPTURED else data_root() / name
    shown = None if root is None else str(root)
    try:
        found = tuple(get_dataset(name, {}).scenes())
    except InputError as error:
        return Listed(name, shown, name not in CAPTURED, (), EXPECTED.get(name, ()), str(error))
    if name not in CAPTURED or root is None:
        return Listed(name, shown, True, found, (), None)
    missing = [scene for scene in EXPECTED[name] if scene not in found]
    missing += [lack for scene in found for lack in _lacks(root / scene, scene)]
    return Listed(name, shown, False, found, tuple(missing), None)


def _lacks(folder: Path, scene: str) -> list[str]:
    """What a scene of a benchmark lacks, from the names of its files alone."""
    if not folder.is_dir():
        return [f"{scene}: its folder"]
    lacks = [] if has_cameras(folder) else [f"{scene}: cameras"]
    try:
        find_splat(folder, scene)
    except InputError as error:
        lacks.append(f"{scene}: {error.message}")
    return lacks


def names(listed: Iterable[str]) -> str:
    """Names in a line; ``none`` where there are none."""
    return ", ".join(listed) or "none"
