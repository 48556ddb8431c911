"""One door to the cameras that a user points at, whatever their format."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from datasets.camera_checks import DistortedCameraError, NamedCameras, is_file, is_folder
from datasets.colmap import colmap_files, has_colmap_model, read_colmap_model
from datasets.inria_cameras import read_inria_cameras
from datasets.picture_folder import FOLDERS
from datasets.transforms_json import is_transforms_json, read_transforms_json
from gvr_core.errors import CameraFormatError

COLMAP_PLACES = ("sparse/0", "sparse", "colmap/sparse/0", "")
"""Where a COLMAP model may lie in a folder, the place to take first. The third is nerfstudio's."""

UNDISTORTED = ("undistorted", "dense", "dense/0")
"""Where undistorted copies of a capture lie; the second and third are COLMAP's own names."""

INRIA, TRANSFORMS = "cameras.json", "transforms.json"

_ACCEPTED = (
    "a cameras.json or transforms.json file, or a folder with one, or with a COLMAP model"
    " (cameras and images as .bin or .txt), itself or in sparse/0"
)


@dataclass(frozen=True, eq=False)
class CameraSource:
    """The cameras of a folder, and where they are from."""

    cameras: NamedCameras
    """Image names and cameras, in name order."""
    files: tuple[Path, ...]
    """The files whose content the cameras are made from."""
    folder: Path
    """The folder whose pictures they belong to: the one asked for, or its undistorted copy."""
    has_endings: bool
    """Whether image names keep their endings; inria's do not."""
    pictures: str | None = None
    """The folder of pictures that the camera file names; None where it names none."""
    notes: tuple[str, ...] = ()
    """What was taken where there was a choice."""


def read_cameras(path: Path | str) -> NamedCameras:
    """The cameras of a file or folder, in name order.

    Args:
        path: A ``cameras.json`` (inria) or ``transforms.json`` (nerfstudio, instant-ngp), or a
            folder as for :func:`find_cameras`.

    Returns:
        Image names and cameras. COLMAP names images with their ending and folders, inria
        without; a folder of pictures that a ``transforms.json`` begins its names with is left out.

    Raises:
        CameraFormatError: if it is neither, or not as its format says.
    """
    path = Path(path)
    if is_folder(path):
        return find_cameras(path).cameras
    if path.suffix.lower() == ".json":
        return _read(path, path.parent).cameras
    found = "no camera file of a known kind" if is_file(path) else "no such file or folder"
    raise CameraFormatError(found, path=path, accepted=_ACCEPTED)


def find_cameras(folder: Path, models: Sequence[Path] = ()) -> CameraSource:
    """The cameras of a folder: COLMAP's first, then inria's, then a ``transforms.json``.

    COLMAP goes first since the others are derived from it, and inria's second since it is in
    the splat's own world frame.

    Args:
        folder: Where to look.
        models: Output folders of the splat's training, which may hold a ``cameras.json``.

    Raises:
        CameraFormatError: if there are none, or those that go first are not as their format
            says. Cameras with distortion are refused, unless an undistorted copy of the capture
            is beside them.
    """
    folder = Path(folder)
    sources = _sources(folder, models)
    if not sources:
        raise CameraFormatError("no cameras in this folder", path=folder, accepted=_ACCEPTED)
    try:
        taken = _read(sources[0], folder)
    except DistortedCameraError as error:
        return _undistorted(folder, sources[0], error)
    left = [_shown(path, folder) for path in sources[1:]]
    if left:
        note = f"cameras are taken from {_shown(sources[0], folder)}, not from {', '.join(left)}"
        return replace(taken, notes=(note, *taken.notes))
    return taken


def has_cameras(folder: Path) -> bool:
    """Whether a folder holds cameras of a known kind, readable or not."""
    return bool(_sources(folder, ()))


def _sources(folder: Path, models: Sequence[Path]) -> list[Path]:
    """COLMAP models and camera files of a folder, the one to take first."""
    colmap = [place for name in COLMAP_PLACES if has_colmap_model(place := folder / name)]
    inria = _distinct([*(m / INRIA for m in models), folder / INRIA, folder / "output" / INRIA])
    return [*colmap, *inria, *_distinct([folder / TRANSFORMS])]


def _read(path: Path, folder: Path) -> CameraSource:
    """The cameras of one source."""
    if is_folder(path):
        cameras = list(read_colmap_model(path).cameras.items())
        return CameraSource(cameras, colmap_files(path), folder, True)
    if is_transforms_json(path):
        cameras = read_transforms_json(path)
        first = {PurePosixPath(name).parts[0] for name, _ in cameras}
        pictures = first.pop() if len(first) == 1 else ""
        if pictures not in FOLDERS:
            return CameraSource(cameras, (path,), folder, True)
        inner = [(name.removeprefix(f"{pictures}/"), camera) for name, camera in cameras]
        return CameraSource(inner, (path,), folder, True, pictures)
    return CameraSource(read_inria_cameras(path), (path,), folder, False)


def _undistorted(folder: Path, source: Path, error: DistortedCameraError) -> CameraSource:
    """The undistorted copy of a capture whose cameras have distortion."""
    for name in UNDISTORTED:
        copy = folder / name
        for place in (copy / inner for inner in COLMAP_PLACES):
            if has_colmap_model(place):
                taken = _read(place, copy)
                note = (
                    f"{_shown(source, folder)} has distortion: cameras and pictures are taken from"
                    f" {name}"
                )
                return replace(taken, notes=(note,))
    raise DistortedCameraError(
        error.message,
        path=error.path,
        place=error.place,
        accepted=f"{error.accepted}, into a folder undistorted/ or dense/ beside it",
    ) from error


def _distinct(paths: Sequence[Path]) -> list[Path]:
    """The files that are there, each once."""
    return list({path.resolve(): path for path in reversed(paths) if is_file(path)}.values())[::-1]


def _shown(path: Path, folder: Path) -> str:
    return str(path.relative_to(folder)) if path.is_relative_to(folder) else str(path)
