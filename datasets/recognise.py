"""Which layout a folder looks like, from the names of what it holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from datasets.camera_checks import is_file, is_folder
from datasets.cameras_file import has_cameras
from datasets.lerf_mask import LERF_MASK, PROMPTS
from datasets.lerf_ovs import NAME as LERF_OVS
from datasets.lerf_ovs import SCENES as OVS_SCENES
from datasets.ovs3d import OVS3D
from datasets.ovs3d import SCENES as OVS3D_SCENES
from gvr_core.errors import DatasetError

NATIVE, CAPTURE = "native", "capture"

EXPECTED = {LERF_OVS: OVS_SCENES, LERF_MASK: tuple(PROMPTS), OVS3D: OVS3D_SCENES}
"""Layout -> the scenes that papers report. A folder with fewer gives another mean over scenes."""


@dataclass(frozen=True)
class Recognised:
    """What a folder looks like."""

    layout: str
    """``lerf_ovs``, ``lerf_mask``, ``ovs3d``, ``native`` or ``capture``."""
    root: Path
    """What the layout's reader takes: the folder, or the one it lies in."""
    scene: str | None
    """The scene that the folder is, where it is one; None where it holds scenes."""
    because: str
    """What it was recognised by."""


def recognise(folder: Path) -> tuple[Recognised, ...]:
    """The layouts that a folder looks like, most telling first; usually one.

    Captures without labels come only where nothing else does, since every layout is made of them.

    Args:
        folder: A scene, or a folder of scenes.

    Raises:
        DatasetError: if it is no folder, or looks like none of them.
    """
    folder = Path(folder)
    if not is_folder(folder):
        raise DatasetError("no such folder", path=folder, accepted="a data set, or a scene of one")
    ways = (
        _lerf_ovs(folder),
        _by_folder(folder, LERF_MASK, "test_mask"),
        _by_folder(folder, OVS3D, "segmentations"),
        _native(folder),
    )
    found = tuple(way for way in ways if way is not None) or _captures(folder)
    if not found:
        raise DatasetError(
            "this looks like no data set",
            path=folder,
            accepted="label/<scene>/*.json beside the scenes (lerf_ovs), <scene>/test_mask"
            " (lerf_mask), <scene>/segmentations (ovs3d), <scene>/scene.json (native), or cameras"
            " in sparse/0, cameras.json or transforms.json (capture)",
        )
    return found


def _lerf_ovs(folder: Path) -> Recognised | None:
    if is_folder(folder / "label"):
        return Recognised(LERF_OVS, folder, None, "label/")
    here = folder.resolve()
    if is_folder(here.parent / "label" / here.name):
        return Recognised(LERF_OVS, here.parent, here.name, f"../label/{here.name}/")
    return None


def _by_folder(folder: Path, layout: str, mark: str) -> Recognised | None:
    """A layout whose scenes hold a folder of that name."""
    if is_folder(folder / mark):
        here = folder.resolve()
        return Recognised(layout, here, here.name, f"{mark}/")
    inner = _inner(folder, lambda path: is_folder(path / mark))
    return Recognised(layout, folder, None, f"{inner[0].name}/{mark}/") if inner else None


def _native(folder: Path) -> Recognised | None:
    if is_file(folder / "scene.json"):
        return Recognised(NATIVE, folder, folder.resolve().name, "scene.json")
    inner = _inner(folder, lambda path: is_file(path / "scene.json"))
    return Recognised(NATIVE, folder, None, f"{inner[0].name}/scene.json") if inner else None


def _captures(folder: Path) -> tuple[Recognised, ...]:
    if has_cameras(folder):
        return (Recognised(CAPTURE, folder, folder.resolve().name, "its cameras"),)
    inner = _inner(folder, has_cameras)
    return tuple(Recognised(CAPTURE, path, path.name, "its cameras") for path in inner)


def _inner(folder: Path, is_one: Callable[[Path], bool]) -> list[Path]:
    """The folders directly in a folder that are what is looked for, hidden ones left out."""
    try:
        inside = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError as error:
        raise DatasetError(f"cannot be listed: {error.strerror}", path=folder) from error
    return [path for path in inside if is_folder(path) and is_one(path)]
