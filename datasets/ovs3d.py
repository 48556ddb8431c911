"""3D-OVS: forward-facing scenes in which a few views are labelled with all classes.

::

    <root>/<scene>/
      images/, sparse/0/, the trained splat     (see `datasets.capture`)
      segmentations/classes.txt                 a class a line
      segmentations/<view>/<class>.png          every class in every folder

A view's folder has its picture's name, or its number among all pictures in name order: the
published reader knows the number alone (Kunhao-Liu/3D-OVS: dataLoader/llff.py). All images are
training images.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from datasets.base import GroundTruth, SceneData
from datasets.capture import Capture, CaptureImage, read_capture
from datasets.frames import match_frame
from datasets.images import MASK_THRESHOLD
from datasets.mask_folders import (
    Notes,
    camera_at_size,
    check_mask,
    check_text,
    digests,
    find_scenes,
    mask_files,
    mask_folders,
    note_extra_folders,
    queries_for,
    scene_folder,
    view_names,
)
from datasets.native_records import check_distinct
from datasets.provenance import is_original
from gvr_core.errors import DatasetError, some_of
from gvr_core.metrics import IN_SCENE_2D, REFUSAL
from gvr_core.scene import Scene, View
from gvr_core.untrusted import read_regular

OVS3D = "ovs3d"

PROTOCOLS = ("ovs3d.binary/1", "ovs3d.exclusive/1", IN_SCENE_2D, REFUSAL)

SCENES = ("bed", "bench", "room", "sofa", "lawn")
"""The scenes that papers report, in their tables' order."""

MASKS, CLASSES = "segmentations", "classes.txt"

NATIVE = range(255, 256)
"""What the published reader takes for foreground: it divides by 255 and cuts to whole numbers."""

FOLDERS = (
    *("images", "images_2", "images_4", "images_8", MASKS, "input", "sparse", "distorted"),
    *("stereo", "dense", "database", "point_cloud", "output", "train", "test"),
)
"""Folders that the data set and the tools around it make in a scene."""


class Ovs3dDataset:
    """The scenes of 3D-OVS.

    Args:
        root: Holds a folder for each scene; or is itself one.
        splats: Folder of the trained splats, where they do not lie with the scenes.
    """

    name = OVS3D

    def __init__(self, root: Path, splats: Path | None = None) -> None:
        self._root = root
        self._splats = splats

    def scenes(self) -> Sequence[str]:
        """Names of the scenes that are there: bed, bench, room, sofa, lawn, then others.

        Raises:
            DatasetError: if there is none.
        """
        return tuple(find_scenes(self._root, SCENES, MASKS))

    def load(self, scene: str) -> SceneData:
        """Read one scene. Methods see all registered images, the labelled ones too.

        Returns:
            A test view is as large as its masks. Classes are queries and objects in one.

        Raises:
            ConfigError: for a scene that is not there.
            DatasetError: for a missing folder, list or mask, masks of a view that has no camera
                or may be one of two, a class that is there twice, or a mask that cannot be used.
            CameraFormatError: for cameras that cannot be used.
            SplatFormatError: for a splat that cannot be used.
        """
        folder = scene_folder(self.name, find_scenes(self._root, SCENES, MASKS), scene, MASKS)
        notes = Notes()
        classes = read_classes(folder / MASKS / CLASSES, notes)
        capture = read_capture(folder, scene, splats=self._splats)
        names = view_names(capture.images, folder)
        views = tuple(View(names[i.name], i.camera, i.path) for i in capture.images)
        test_views, masks = _read_masks(folder / MASKS, classes, capture, names, notes)
        note_extra_folders(folder, FOLDERS, notes)
        queries = queries_for(classes)
        return SceneData(
            Scene(self.name, scene, capture.gaussians, views),
            queries,
            GroundTruth(classes, test_views, masks),
            digests(capture.ply, views, queries, test_views, classes, masks),
            PROTOCOLS,
            (*capture.notes, *notes.lines()),
            is_original(folder, SCENES),
        )


def read_classes(path: Path, notes: Notes) -> tuple[str, ...]:
    """The classes of a scene, sorted as the published reader sorts them.

    Args:
        path: A text file with a class a line.
        notes: Told of a byte order mark, Windows' line ends, blank lines and outer spaces.

    Raises:
        DatasetError: if the file is missing, no UTF-8, empty, or names a class twice or one that
            no file can be called.
    """
    try:
        text = read_regular(path).decode("utf-8")
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror}", path=path) from error
    except UnicodeDecodeError as error:
        raise DatasetError(f"no text: {error.reason}", path=path, accepted="UTF-8") from error
    if text.startswith("\ufeff"):
        notes.add(f"byte order marks in {CLASSES}, dropped", "line 1")
        text = text.removeprefix("\ufeff")
    lines = text.removesuffix("\n").split("\n") if text else []
    classes = []
    for number, line in enumerate(lines, start=1):
        place = f"line {number}"
        if line.endswith("\r"):
            notes.add(f"Windows' line ends in {CLASSES}, dropped", place)
            line = line.removesuffix("\r")
        name = line.strip()
        if not name:
            notes.add(f"blank lines in {CLASSES}, dropped", place)
            continue
        if name != line:
            notes.add(f"outer spaces in {CLASSES}, dropped", place)
        check_text(name, path, place)
        if "/" in name or "\\" in name or name in (".", ".."):
            raise DatasetError(
                f"no mask can be called {name!r}", path=path, place=place, accepted="a file name"
            )
        classes.append(name)
    if not classes:
        raise DatasetError("no class", path=path, accepted="a class a line")
    check_distinct(classes, "class", path)
    return tuple(sorted(classes))


def _read_masks(
    folder: Path,
    classes: Sequence[str],
    capture: Capture,
    names: Mapping[str, str],
    notes: Notes,
) -> tuple[tuple[View, ...], dict[tuple[str, str], Path]]:
    """The labelled views in name order, and their masks by (view, class)."""
    places: dict[str, Path] = {}
    sizes: dict[str, tuple[int, int]] = {}
    masks: dict[tuple[str, str], Path] = {}
    for place in mask_folders(folder, notes, (CLASSES,)):
        files = mask_files(place, notes)
        if not files and not _is_number(place.name):
            notes.add(f"folders in {MASKS}/ without masks, left out", place.name)
            continue
        image = _labelled_image(place, capture, notes)
        view = names[image.name]
        if view in places:
            raise DatasetError(
                f"holds masks of the view {view!r}, as {places[view].name}/ does",
                path=place,
                accepted="one folder for each view",
            )
        places[view] = place
        size = None
        for name, path in _class_files(place, files, classes, notes).items():
            size = check_mask(path, MASK_THRESHOLD, NATIVE, size, notes)
            masks[view, name] = path
            sizes[view] = size
    if not masks:
        raise DatasetError("no mask", path=folder, accepted="<view>/<class>.png")
    views = []
    for image in capture.images:
        view = names[image.name]
        if view in places:
            camera = camera_at_size(image.camera, sizes[view], places[view], notes)
            views.append(View(view, camera, image.path))
    return tuple(views), masks


def _labelled_image(place: Path, capture: Capture, notes: Notes) -> CaptureImage:
    """The image that a folder of masks belongs to: by name, else by number."""
    name = place.name
    index = int(name) if _is_number(name) else None
    pictures = len(capture.images) + len(capture.unregistered)
    if index is not None and index >= pictures:
        # A number that counts no picture can still be the name of one.
        named = [i.name for i in capture.images if Path(i.name).stem == name]
        if named:
            notes.add("folders that are the name of a picture, and as a number beyond all", name)
            index = None
    return match_frame(capture.images, name, index, unregistered=capture.unregistered, path=place)


def _is_number(name: str) -> bool:
    return name.isascii() and name.isdecimal()


def _class_files(
    place: Path, files: Sequence[Path], classes: Sequence[str], notes: Notes
) -> dict[str, Path]:
    """The mask of every class in a view's folder."""
    found: dict[str, Path] = {}
    for path in files:
        name = path.stem.strip()
        if name not in classes:
            notes.add(f"masks of no class of {CLASSES}, left out", f"{place.name}/{path.name}")
            continue
        if name in found:
            raise DatasetError(
                f"the class {name!r} has another mask, {found[name].name!r}",
                path=path,
                accepted="one mask for each class",
            )
        if name != path.stem:
            notes.add("outer spaces in names of masks, dropped", f"{place.name}/{path.name}")
        found[name] = path
    missing = [name for name in classes if name not in found]
    if missing:
        raise DatasetError(
            f"no mask of {some_of(missing)}",
            path=place,
            accepted=f"<class>.png for each of the {len(classes)} classes of {CLASSES}",
        )
    return {name: found[name] for name in classes}
