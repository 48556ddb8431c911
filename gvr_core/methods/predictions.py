"""``predictions``: someone else's answers, read from a folder, so that they are scored as ours are.

::

    <folder>/<scene>/<view>/<prompt>.png     a mask, or a grey map of it, of the labels' size
    <folder>/<scene>/<view>/<prompt>.npy     relevancy maps, (H, W) or (L, H, W) float
    <folder>/<scene>/flags/<prompt>.npy      (N,) bool, or rows of the flagged Gaussians, from 0

A scene has either pictures or flags. ``<prompt>`` is the text as the data set writes it; where
that cannot be a file name, the query's id. ``<view>`` is the test view's name. A file that is not
there is a prediction that was not made: the protocol says what that costs.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import BaseModel, ConfigDict

from gvr_core.atomic import file_digest
from gvr_core.books import Books
from gvr_core.errors import DatasetError
from gvr_core.localize import Localization
from gvr_core.methods.base import Grounding, nothing_found
from gvr_core.scene import Query, Scene
from gvr_core.workspace import Workspace

FLAGS = "flags"
"""Name of the folder of per-Gaussian flags, in place of a view's."""

MODES = ("1", "L", "RGB")
"""Pillow's modes of pictures whose grey value says all that they hold."""

LARGEST = 2**31
"""Bytes of the largest array that is read: a header may promise anything."""


class PredictionsConfig(BaseModel):
    """Where the predictions lie."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    folder: Path | None = None
    """Folder of scenes."""

    def digest(self) -> str:
        """sha256 over the names and contents of all files; goes into cache keys.

        Raises:
            DatasetError: if no folder is named, or it is not there.
        """
        root, digest = _root(self), hashlib.sha256()
        for path in sorted(_files(root, frozenset())):
            digest.update(f"{path.relative_to(root).as_posix()} {file_digest(path)}\n".encode())
        return digest.hexdigest()


class Predictions:
    """Answers out of a folder.

    Args:
        config: Where they lie.
        name: Shown in tables.

    Raises:
        DatasetError: if the folder is not there.
    """

    def __init__(self, config: PredictionsConfig, name: str = "predictions") -> None:
        self._root = _root(config)
        self._name = name

    @property
    def name(self) -> str:
        """The method's name."""
        return self._name

    def prepare(self, scene: Scene) -> Books:
        """No books: all is known already."""
        return Books.none()

    def index(self, scene: Scene, books: Books) -> dict[str, NDArray[Any]]:
        """Nothing."""
        return {}

    def ground(self, scene: Scene, books: Books, query: Query) -> Grounding:
        """Read the answer to one query; see :meth:`segment`."""
        return self.segment(scene, books, None, query)

    def share(self, scene: Scene, books: Books, queries: Sequence[Query]) -> Workspace:
        """Nothing is compared."""
        return Workspace(books.semantics.features, None)

    def locate(
        self, scene: Scene, books: Books, query: Query, shared: Workspace | None = None
    ) -> Localization | None:
        """Nothing: predictions have no place."""
        return None

    def segment(
        self,
        scene: Scene,
        books: Books,
        localization: Localization | None,
        query: Query,
        shared: Workspace | None = None,
    ) -> Grounding:
        """Read the answer to one query.

        Returns:
            Flags, where the scene's folder has them; else pictures by view, and flags that are
            all False. Found means that anything is set in any of them; answered, that there is
            a file at all.

        Raises:
            DatasetError: for a file that cannot be read or is of another kind, a prompt with a
                .png and a .npy, a scene without a folder, or with one that holds both flags and
                views.
        """
        folder = self._scene(scene.name)
        flags = folder / FLAGS
        nothing = nothing_found(scene)
        if flags.is_dir():
            path = _find(flags, query, (".npy",))
            if path is None:
                return replace(nothing, answered=False)
            flagged = _read_flags(path, len(scene.gaussians))
            return replace(
                nothing,
                flags=flagged,
                scores=flagged.astype(np.float32),
                found=bool(flagged.any()),
                confidence=float(flagged.any()),
            )
        given = {}
        for view in sorted(path for path in folder.iterdir() if path.is_dir()):
            path = _find(view, query, (".png", ".npy"))
            if path is not None:
                given[view.name] = _read_mask(path) if path.suffix == ".png" else _read_maps(path)
        found = any(bool(picture.any()) for picture in given.values())
        return replace(
            nothing, given=given, found=found, confidence=float(found), answered=bool(given)
        )

    def _scene(self, name: str) -> Path:
        folder = self._root / name
        if not folder.is_dir():
            known = sorted(path.name for path in self._root.iterdir() if path.is_dir())
            raise DatasetError(
                f"there are no predictions for the scene {name!r}",
                path=self._root,
                accepted=f"a folder of that name; there are: {', '.join(known) or 'none'}",
            )
        views = [path.name for path in folder.iterdir() if path.is_dir() and path.name != FLAGS]
        if views and (folder / FLAGS).is_dir():
            raise DatasetError(
                f"holds {FLAGS}/ and the views {', '.join(sorted(views)[:3])}",
                path=folder,
                accepted="flags or views, not both",
            )
        return folder


def _root(config: PredictionsConfig) -> Path:
    if config.folder is None:
        raise DatasetError(
            "the method 'predictions' has no folder", accepted='predictions = { folder = "..." }'
        )
    folder = config.folder.expanduser()
    if not folder.is_dir():
        raise DatasetError("no such folder of predictions", path=folder)
    return folder


def _files(folder: Path, above: frozenset[Path]) -> Iterator[Path]:
    """All files below a folder; links are followed, as they are where answers are read."""
    here = folder.resolve()
    if here in above:
        raise DatasetError("a link leads back to a folder above it", path=folder)
    for path in folder.iterdir():
        if path.is_dir():
            yield from _files(path, above | {here})
        elif path.is_file():
            yield path


def _find(folder: Path, query: Query, endings: tuple[str, ...]) -> Path | None:
    """The file of a query; None where there is none."""
    stem = query.id if "/" in query.text or query.text.startswith(".") else query.text
    names = {f"{stem}{ending}" for ending in endings}
    found = sorted(path for path in folder.iterdir() if path.name in names and path.is_file())
    if len(found) > 1:
        raise DatasetError(
            f"{found[0].name} and {found[1].name} both answer {query.text!r}",
            path=folder,
            accepted="one of them",
        )
    return found[0] if found else None


def _read_mask(path: Path) -> NDArray[np.uint8]:
    try:
        with Image.open(path, formats=("PNG",)) as picture:
            mode, grey = picture.mode, np.array(picture.convert("L"))
    except Exception as error:  # decoders answer damaged files with errors of many kinds
        raise DatasetError(f"cannot be decoded: {error}", path=path, accepted="a PNG") from error
    if mode not in MODES:
        raise DatasetError(
            f"pixels of the mode {mode}",
            path=path,
            accepted="black and white, 8-bit grey or RGB: no palette, no alpha, no 16 bits",
        )
    if grey.max() == 1:
        raise DatasetError(
            "all pixels are 0 or 1", path=path, accepted="a mask of 0 and 255, or grey values"
        )
    return grey


def _read_maps(path: Path) -> NDArray[np.float32]:
    maps = _read_array(path)
    if maps.ndim == 2:
        maps = maps[None]
    if maps.ndim != 3 or not maps.size or maps.dtype.kind != "f":
        raise DatasetError(
            f"an array of shape {maps.shape} and dtype {maps.dtype}",
            path=path,
            accepted="relevancies, (H, W) or (L, H, W) float",
        )
    if not (np.isfinite(maps).all() and maps.min() >= 0 and maps.max() <= 1):
        raise DatasetError(
            f"values from {maps.min()} to {maps.max()}",
            path=path,
            accepted="relevancies from 0 to 1, as LERF defines them",
        )
    return maps.astype(np.float32)


def _read_flags(path: Path, n: int) -> NDArray[np.bool_]:
    array = _read_array(path)
    if array.shape == (n,) and array.dtype == np.bool_:
        return array
    flags = np.zeros(n, np.bool_)
    rows = array if array.ndim == 1 and array.dtype.kind in "iu" else None
    if (
        rows is None
        or (len(rows) and not 0 <= rows.min() <= rows.max() < n)
        # Zeros and ones for each Gaussian are a mask that lost its type, and no rows.
        or len(np.unique(rows)) < len(rows)
    ):
        raise DatasetError(
            f"an array of shape {array.shape} and dtype {array.dtype}",
            path=path,
            accepted=f"({n},) bool, or rows of Gaussians from 0 to {n - 1}, each once",
        )
    flags[rows] = True
    return flags


def _read_array(path: Path) -> NDArray[Any]:
    try:
        # Mapped: only what the file really holds can be read, whatever its header says.
        mapped = np.load(path, mmap_mode="r", allow_pickle=False)
        if mapped.nbytes > LARGEST:
            raise ValueError(f"{mapped.nbytes:,} bytes")
        return np.array(mapped)
    except (OSError, ValueError, EOFError) as error:
        raise DatasetError(
            f"cannot be read: {error}", path=path, accepted="a .npy file of numbers"
        ) from error
