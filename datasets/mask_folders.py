"""What the benchmarks share that keep their masks as pictures in a folder for each view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import numpy as np

from datasets.camera_checks import is_folder
from datasets.capture import CaptureImage
from datasets.digests import digest_of, view_parts
from datasets.images import FORMATS, is_transparent, read_mask
from datasets.making import slug
from datasets.native_records import check_distinct
from gvr_core.atomic import file_digest
from gvr_core.cameras import Camera
from gvr_core.errors import DatasetError, some_of, unknown_name
from gvr_core.picture_files import open_picture
from gvr_core.scene import Query, View

JUNK = frozenset({"thumbs.db", "desktop.ini", "__macosx"})
"""Left behind by file managers, in lower case; with hidden files they are passed over."""

LONGEST_TEXT = 400
"""Characters of a prompt: what a query takes."""


@dataclass
class Notes:
    """What was put right or left out on reading, counted by kind."""

    _found: dict[str, list[str]] = field(default_factory=dict)

    def add(self, what: str, where: str) -> None:
        """Count one more case.

        Args:
            what: The kind of it; what was done about it.
            where: The file, class or line concerned.
        """
        self._found.setdefault(what, []).append(where)

    def lines(self) -> tuple[str, ...]:
        """One line for each kind: what, how often, and the first few places."""
        return tuple(f"{what}: {len(w)} ({some_of(w)})" for what, w in self._found.items())


def entries(folder: Path) -> list[Path]:
    """Files and folders in a folder by name, without hidden ones and what file managers leave.

    Raises:
        DatasetError: if the folder is not there, or cannot be listed.
    """
    try:
        found = sorted(folder.iterdir())
    except OSError as error:
        raise DatasetError(f"cannot be listed: {error.strerror}", path=folder) from error
    return [p for p in found if not p.name.startswith(".") and p.name.lower() not in JUNK]


def mask_folders(folder: Path, notes: Notes, known: Sequence[str] = ()) -> list[Path]:
    """The folders in a folder of masks; loose files in it are noted, but for the known ones.

    Raises:
        DatasetError: if there is none.
    """
    listed = entries(folder)
    for path in listed:
        if not is_folder(path) and path.name not in known:
            notes.add(f"files in {folder.name}/ outside its folders, left out", path.name)
    found = [path for path in listed if is_folder(path)]
    if not found:
        raise DatasetError("no view has masks", path=folder, accepted="a folder for each view")
    return found


def mask_files(folder: Path, notes: Notes) -> list[Path]:
    """The PNG files in a view's folder; everything else in it is noted."""
    found = []
    for path in entries(folder):
        place = f"{folder.name}/{path.name}"
        if is_folder(path):
            notes.add("folders among the masks, left out", place)
        elif path.suffix.lower() != ".png":
            notes.add("files that are no PNG among the masks, left out", place)
        else:
            found.append(path)
    return found


def check_text(text: str, path: Path, place: str | None = None) -> str:
    """A prompt or class name that can be asked for.

    Raises:
        DatasetError: if it is blank, too long, or holds control characters.
    """
    if not text.strip() or not text.isprintable() or len(text) > LONGEST_TEXT:
        raise DatasetError(
            f"the text {text[:60]!r} cannot be a prompt",
            path=path,
            place=place,
            accepted=f"1 to {LONGEST_TEXT} printable characters",
        )
    return text


def check_mask(
    path: Path, threshold: int, native: range, size: tuple[int, int] | None, notes: Notes
) -> tuple[int, int]:
    """Decode a mask, and note what its data set's own reader would see in it otherwise.

    Args:
        path: The picture.
        threshold: Foreground is brighter than this, and at least half opaque.
        native: Grey values that the published reader takes for foreground; it knows no alpha.
        size: Width and height of the view's other masks; None for its first.
        notes: Gets the findings.

    Returns:
        Width and height, pixels.

    Raises:
        DatasetError: for a picture that cannot be decoded, or is not as large as the others.
    """
    place = f"{path.parent.name}/{path.name}"
    mask = read_mask(path, threshold=threshold)
    found = (mask.shape[1], mask.shape[0])
    if size is not None and found != size:
        raise DatasetError(
            f"the mask has {found[0]} x {found[1]} pixels",
            path=path,
            accepted=f"{size[0]} x {size[1]}, as the view's other masks have",
        )
    with open_picture(path, FORMATS) as picture:
        if is_transparent(picture):
            notes.add("masks with an alpha channel, transparent taken for background", place)
        grey = np.asarray(picture.convert("L"))
    if grey.any() and not mask.any():
        notes.add(f"masks that are not black, yet empty: nothing is above {threshold}", place)
    if (((grey >= native.start) & (grey < native.stop)) != mask).any():
        notes.add("masks that the published evaluator would read otherwise", place)
    return found


def camera_at_size(camera: Camera, size: tuple[int, int], folder: Path, notes: Notes) -> Camera:
    """A test view's camera with as many pixels as its masks have.

    Args:
        camera: The camera as its file has it.
        size: Width and height of the masks.
        folder: The masks' folder.
        notes: Told where the sizes differ.

    Raises:
        DatasetError: if the masks have another shape than the picture, by more than rounding.
    """
    if size == (camera.width, camera.height):
        return camera
    across, down = size[0] / camera.width, size[1] / camera.height
    # Each side of a picture that was made smaller is rounded by up to a pixel.
    rounding = max(1.0, across, down) * (1 / camera.width + 1 / camera.height)
    if abs(across - down) > rounding:
        raise DatasetError(
            f"the masks have {size[0]} x {size[1]} pixels",
            path=folder,
            accepted=f"{camera.width} x {camera.height}, as the camera has, or a multiple of it",
        )
    stated = f"{size[0]} x {size[1]} for {camera.width} x {camera.height}"
    notes.add("test views scored at their masks' size", f"{folder.name}: {stated}")
    return camera.resized(*size)


def view_names(images: Sequence[CaptureImage], folder: Path) -> dict[str, str]:
    """Image name -> name of its view: the file name without ending, with its folders if need be.

    Raises:
        DatasetError: if two images would get one name.
    """
    stems = {image.name: PurePosixPath(image.name).stem for image in images}
    if len(set(stems.values())) < len(stems):
        stems = {
            image.name: PurePosixPath(image.name).with_suffix("").as_posix().replace("/", "_")
            for image in images
        }
    check_distinct(list(stems.values()), "view", folder)
    return stems


def queries_for(objects: Sequence[str]) -> tuple[Query, ...]:
    """A query for each object, with the object's name as its text."""
    queries: dict[str, Query] = {}
    for text in objects:
        first = name = slug(text)[:56]
        count = 1
        while name in queries:
            count += 1
            name = f"{first}-{count}"
        queries[name] = Query(id=name, text=text, target=text)
    return tuple(queries.values())


def find_scenes(root: Path, published: Sequence[str], marker: str) -> dict[str, Path]:
    """The scenes under a data set's folder: the published ones in their order, then others.

    Args:
        root: Holds a folder for each scene; or is itself one.
        published: Names of the scenes that the data set is known for; those are listed even
            without masks, so that what is missing is said and not passed over.
        marker: The folder of masks that makes a folder a scene.

    Raises:
        DatasetError: if there is none.
    """
    if is_folder(root / marker):
        return {root.resolve().name: root}
    folders = {path.name: path for path in entries(root) if is_folder(path)}
    found = {name: folders[name] for name in published if name in folders}
    found |= {name: path for name, path in folders.items() if is_folder(path / marker)}
    if not found:
        raise DatasetError(
            "no scene here",
            path=root,
            accepted=f"folders with {marker}/ in them: {', '.join(published)}",
        )
    return found


def scene_folder(dataset: str, scenes: Mapping[str, Path], scene: str, marker: str) -> Path:
    """A scene's folder, which must hold its masks.

    Raises:
        ConfigError: for a scene that is not there.
        DatasetError: for one without masks.
    """
    if scene not in scenes:
        raise unknown_name(f"scene of {dataset}", scene, scenes)
    if not is_folder(scenes[scene] / marker):
        raise DatasetError("missing folder", path=scenes[scene] / marker, accepted="the masks")
    return scenes[scene]


def note_extra_folders(folder: Path, known: Sequence[str], notes: Notes) -> None:
    """Note the folders of a scene that no part of its layout is known to make."""
    for path in entries(folder):
        if is_folder(path) and path.name not in known:
            notes.add("folders that the layout does not have, left out", path.name)


def digests(
    ply: Path,
    views: Sequence[View],
    queries: Sequence[Query],
    test_views: Sequence[View],
    objects: Sequence[str],
    masks: Mapping[tuple[str, str], Path],
) -> dict[str, str]:
    """What `datasets.base.SceneData.digests` holds, of a scene without 3D labels."""
    return {
        "gaussians": file_digest(ply),
        "views": digest_of(view_parts(view, True) for view in views),
        "queries": digest_of(query.model_dump_json() for query in queries),
        "truth": digest_of(
            [
                repr(tuple(objects)),
                *(view_parts(view, False) for view in test_views),
                *(f"{v}/{o}:{file_digest(p)}" for (v, o), p in sorted(masks.items())),
            ]
        ),
    }
