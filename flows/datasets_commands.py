"""What ``gvr datasets`` does; each function is one command, usable without a shell."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console

from datasets.base import Dataset, SceneData
from datasets.cameras_file import has_cameras
from datasets.capture import read_capture, read_images
from datasets.composite import splats_folder
from datasets.export_lerf_mask import export_lerf_mask
from datasets.export_lerf_ovs import export_lerf_ovs
from datasets.export_ovs3d import export_ovs3d
from datasets.lerf_mask import LERF_MASK
from datasets.lerf_ovs import NAME as LERF_OVS
from datasets.ovs3d import OVS3D
from datasets.recognise import CAPTURE, EXPECTED, NATIVE, Recognised, recognise
from datasets.registry import (
    CAPTURED,
    DATASETS,
    FOLDER,
    benchmark_root,
    data_root,
    get_dataset,
)
from datasets.splat_places import find_splat
from gvr_core.errors import ConfigError, InputError, unknown_name
from gvr_core.rendering import get_renderer

EXIT_BAD_INPUT = 2

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


EXPORTS: dict[str, Callable[..., Path]] = {
    LERF_OVS: export_lerf_ovs,
    LERF_MASK: export_lerf_mask,
    OVS3D: export_ovs3d,
}
"""Layouts that scenes can be written in."""


def datasets_export(dataset: str, scene: str, layouts: Sequence[str], out: Path) -> None:
    """``gvr datasets export``: a scene with exact truth, in published layouts.

    Args:
        dataset: Name of the data set.
        scene: Name of the scene.
        layouts: Names of the layouts; all where none is given.
        out: Gets a folder for each layout, which may be given as GVR_DATASETS then.

    Raises:
        ConfigError: for a name that is not known.
        DatasetError: for a scene that cannot be read, or has no room in a layout.
    """
    for layout in layouts:
        if layout not in EXPORTS:
            raise unknown_name("layout", layout, EXPORTS)
    data = get_dataset(dataset, {}).load(scene)
    for layout in layouts or EXPORTS:
        folder = EXPORTS[layout](data, out / layout, get_renderer("numba"))
        Console(soft_wrap=True).print(str(folder), markup=False, highlight=False)


def datasets_ls(as_json: bool) -> None:
    """``gvr datasets ls``.

    Args:
        as_json: Print everything that is known, in place of the table.
    """
    listing = [_listed(name) for name in DATASETS]
    if as_json:
        print(json.dumps([asdict(item) for item in listing], indent=1))
        return
    for item in listing:
        state = " (made on first use)" if item.made else ""
        _say(f"{item.name}  {item.root or 'nowhere: GVR_DATASETS is not set'}{state}")
        if item.problem is None:
            _say(f"  scenes:  {_names(item.found)}")
        elif item.root is not None:
            _say(f"  problem: {item.problem}")
        if item.missing:
            _say(f"  missing: {_names(item.missing)}")


def datasets_where() -> None:
    """``gvr datasets where``."""
    for variable, meaning in VARIABLES.items():
        _say(f"{variable} = {os.environ.get(variable) or '(not set)'}  {meaning}")
    _say("")
    for name in CAPTURED:
        root = benchmark_root(name)
        _say(f"{name}: {_there(root) if root else 'nowhere: GVR_DATASETS is not set'}")
    _say(f"made scenes: {_there(data_root())}")
    try:
        _say(f"captured splats: {splats_folder()}")
    except InputError as error:
        _say(f"captured splats: {error}")


def datasets_check(
    path: Path, layout: str | None = None, splats: Path | None = None, splat: Path | None = None
) -> int:
    """``gvr datasets check``: read a folder as the layout it looks like.

    One scene that cannot be read does not keep the others from being read.

    Args:
        path: A data set's folder, or a scene of one.
        layout: The layout, where the folder looks like several.
        splats: Folder of trained splats by scene.
        splat: Trained splat of a capture.

    Returns:
        Exit code: 0, or 2 where a scene could not be read.

    Raises:
        DatasetError: for no folder, or one that looks like no data set.
        ConfigError: for a layout that it does not look like, or several and none named.
    """
    chosen = _chosen(recognise(path), path, layout)
    first = chosen[0]
    if first.layout == CAPTURE:
        return max(_check_capture(item, splat, splats) for item in chosen)
    if splat is not None:
        raise ConfigError("--splat names the splat of a single capture", accepted="--splats")
    _say(f"{path}: {first.layout}, by {first.because}")
    dataset = _dataset(first, splats)
    there = tuple(dataset.scenes())
    _say(f"found: {_names(there)}")
    if first.layout in EXPECTED and first.scene is None:
        expected = EXPECTED[first.layout]
        _say(f"expected: {_names(expected)}")
        _say(f"missing: {_names(name for name in expected if name not in there)}")
    wanted = there if first.scene is None else (first.scene,)
    return max(_check_scene(dataset, scene) for scene in wanted)


def _chosen(
    found: tuple[Recognised, ...], path: Path, layout: str | None
) -> tuple[Recognised, ...]:
    """What of the layouts that a folder looks like is to be read."""
    layouts = list(dict.fromkeys(item.layout for item in found))
    if layout is None and len(layouts) > 1:
        reasons = ", ".join(f"{item.layout} by {item.because}" for item in found)
        raise ConfigError(
            f"the folder looks like {reasons}", path=path, accepted="--as, with one of them"
        )
    if layout is not None and layout not in layouts:
        if layout == CAPTURE and has_cameras(path):
            return (Recognised(CAPTURE, path, path.resolve().name, "--as"),)
        if layout not in (*EXPECTED, NATIVE, CAPTURE):
            raise unknown_name("layout", layout, (*EXPECTED, NATIVE, CAPTURE))
        raise ConfigError(
            f"the folder does not look like {layout}", path=path, accepted=", ".join(layouts)
        )
    return tuple(item for item in found if layout in (None, item.layout))


def _dataset(item: Recognised, splats: Path | None) -> Dataset:
    """The reader of a layout, on a folder."""
    if item.layout == NATIVE:
        return get_dataset(f"{FOLDER}{item.root}", {})
    settings = {"root": str(item.root)}
    if splats is not None:
        settings["splats"] = str(splats)
    return get_dataset(item.layout, settings)


def _check_scene(dataset: Dataset, scene: str) -> int:
    """Read one scene, and say what is in it."""
    try:
        data = dataset.load(scene)
    except InputError as error:
        _complain(f"{scene}: {error}")
        return EXIT_BAD_INPUT
    _say(f"{scene}: {_described(data)}")
    _say_notes(data.notes)
    return 0


def _described(data: SceneData) -> str:
    truth, views = data.truth, data.scene.views
    pairs = [(view, name) for view in truth.test_views for name in truth.objects]
    labelled = sum(truth.is_labelled(view, name) for view, name in pairs)
    pictures = sum(view.image is not None for view in views)
    return (
        f"{len(data.scene.gaussians)} Gaussians, {len(views)} views ({pictures} with a picture),"
        f" {len(truth.test_views)} test views, {len(truth.objects)} objects, {labelled} of"
        f" {len(pairs)} pairs labelled, {len(data.queries)} queries; scored by"
        f" {', '.join(data.protocols)}"
    )


def _check_capture(item: Recognised, splat: Path | None, splats: Path | None) -> int:
    """Read a capture without labels, its cameras first: they may be right where it has no splat."""
    name = item.scene or item.root.resolve().name
    _say(f"{item.root}: {CAPTURE}, by {item.because}")
    try:
        captured = read_images(item.root)
        pictures = sum(image.path is not None for image in captured.images)
        _say(
            f"{name}: {len(captured.images)} registered images ({pictures} with a picture), cameras"
            f" from {_names(str(path) for path in captured.camera_files)}"
        )
        if captured.unregistered:
            _say(
                f"  {len(captured.unregistered)} pictures without a camera:"
                f" {_names(captured.unregistered[:3])}"
            )
        _say_notes(captured.notes)
        capture = read_capture(item.root, name, splat, splats)
    except InputError as error:
        _complain(f"{name}: {error}")
        return EXIT_BAD_INPUT
    _say(f"{name}: {len(capture.gaussians)} Gaussians from {capture.ply}")
    _say_notes([note for note in capture.notes if note not in captured.notes])
    return 0


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


def _there(folder: Path) -> str:
    return f"{folder}{'' if folder.is_dir() else ' (not there)'}"


def _names(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"


def _say_notes(notes: Sequence[str]) -> None:
    for note in notes:
        _say(f"  note: {note}")


def _say(text: str) -> None:
    Console(soft_wrap=True).print(text, markup=False, highlight=False)


def _complain(text: str) -> None:
    Console(stderr=True, soft_wrap=True).print(
        f"gvr: {text}", style="red", markup=False, highlight=False
    )
