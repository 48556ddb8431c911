"""One door to the cameras that a user points at, whatever their format."""

from __future__ import annotations

from pathlib import Path

from datasets.camera_checks import NamedCameras, is_file, is_folder
from datasets.colmap import has_colmap_model, read_colmap_model
from datasets.inria_cameras import read_inria_cameras
from gvr_core.errors import CameraFormatError

_ACCEPTED = (
    "a cameras.json file, or a folder with a COLMAP model (cameras and images as .bin or .txt),"
    " itself or in sparse/0"
)


def read_cameras(path: Path | str) -> NamedCameras:
    """The cameras of a file or folder, in name order.

    Args:
        path: A ``cameras.json``, or a folder that holds a COLMAP model, itself or in
            ``sparse/0``.

    Returns:
        Image names and cameras. COLMAP names images with their ending and folders, inria
        without.

    Raises:
        CameraFormatError: if it is neither, or not as its format says.
    """
    path = Path(path)
    if is_folder(path):
        for folder in (path, path / "sparse" / "0"):
            if has_colmap_model(folder):
                return list(read_colmap_model(folder).cameras.items())
        raise CameraFormatError("no cameras in this folder", path=path, accepted=_ACCEPTED)
    if path.suffix.lower() == ".json":
        return read_inria_cameras(path)
    found = "no camera file of a known kind" if is_file(path) else "no such file or folder"
    raise CameraFormatError(found, path=path, accepted=_ACCEPTED)
