"""The photographs of a capture: which are there, how they are called, how large they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from datasets.camera_checks import is_file, is_folder
from datasets.images import FORMATS
from gvr_core.errors import DatasetError, some_of
from gvr_core.picture_files import open_picture

FOLDERS = ("images", "images_2", "images_4", "images_8")
"""Folders of pictures, the one to take first."""

ENDINGS = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")
"""Endings of pictures, in lower case."""


@dataclass(frozen=True, eq=False)
class PictureFolder:
    """The pictures below a capture's folder."""

    base: Path
    """The capture's folder."""
    folder: Path | None
    """Where its pictures lie; None where there is no such folder."""
    names: Sequence[str]
    """Pictures below ``folder`` as relative POSIX paths, in name order."""
    _known: frozenset[str] = field(init=False)
    _whole: dict[str, list[str]] = field(init=False, default_factory=dict)
    _short: dict[str, list[str]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_known", frozenset(self.names))
        for name in self.names:
            path = PurePosixPath(name)
            self._whole.setdefault(str(path.with_suffix("")), []).append(name)
            self._short.setdefault(path.name.split(".")[0], []).append(name)

    @classmethod
    def of(cls, base: Path, first: str | None = None) -> PictureFolder:
        """The pictures of a capture: ``images``, else the largest of its scaled copies.

        Args:
            base: The capture's folder.
            first: A folder in it that goes before these.
        """
        tries = FOLDERS if first is None else (first, *FOLDERS)
        folder = next((base / name for name in tries if is_folder(base / name)), None)
        return cls(base, folder, [] if folder is None else picture_names(folder))

    def path(self, name: str) -> Path:
        """Where a picture of this folder lies."""
        return (self.base if self.folder is None else self.folder) / name

    def exact(self, name: str) -> str | None:
        """The picture that a camera file names, with or without the folder of pictures."""
        return next((found for found in _names(name) if found in self._known), None)

    def like(self, name: str, has_ending: bool) -> str | None:
        """The picture that has a camera's name but for its ending.

        Args:
            name: As the camera file has it.
            has_ending: Whether the camera file keeps endings. Where not, it is taken for one of
                inria's, which keep a name up to its first dot and without its folders.

        Raises:
            DatasetError: if several have.
        """
        for inner in _names(name):
            if has_ending:
                found = self._whole.get(str(PurePosixPath(inner).with_suffix("")), [])
            else:
                found = self._whole.get(inner) or self._short.get(inner, [])
            if len(found) > 1:
                raise DatasetError(
                    f"the camera of {name!r} may mean {some_of(found)}",
                    path=self.folder,
                    accepted="one picture of that name",
                )
            if found:
                return found[0]
        return None

    def elsewhere(self, name: str) -> Path | None:
        """The picture that a camera file names by its path from the capture's folder."""
        tries = (self.base / name, *(self.base / f"{name}{ending}" for ending in ENDINGS))
        return next(
            (path for path in tries if path.suffix.lower() in ENDINGS and is_file(path)), None
        )


def _names(name: str) -> tuple[str, ...]:
    """A name as it is, and without the folder of pictures where it begins with one."""
    parts = PurePosixPath(name).parts
    return (name, str(PurePosixPath(*parts[1:]))) if parts[0] in FOLDERS and parts[1:] else (name,)


def picture_names(folder: Path) -> list[str]:
    """The pictures below a folder as relative POSIX paths, in name order, hidden ones left out."""
    found = (path.relative_to(folder) for path in folder.rglob("*") if is_file(path))
    return sorted(
        path.as_posix()
        for path in found
        if path.suffix.lower() in ENDINGS and not any(part.startswith(".") for part in path.parts)
    )


def picture_size(path: Path) -> tuple[int, int]:
    """Width and height of a picture in pixels, from its header, as stored.

    Raises:
        DatasetError: if it is missing or no picture.
    """
    if not is_file(path):
        raise DatasetError("missing picture", path=path, accepted=f"a {', '.join(FORMATS)}")
    with open_picture(path, FORMATS) as picture:
        return picture.size
