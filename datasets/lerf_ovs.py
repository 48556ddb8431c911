"""LERF-OVS: captures of LERF with the labels that LangSplat published for some of their frames.

::

    <root>/
      <scene>/{images/, sparse/0/, a trained splat}       see `datasets.capture`
      label/<scene>/frame_XXXXX.json                      polygons and boxes by category
      label/<scene>/frame_XXXXX.jpg                       the labelled picture

The layout: minghanqin/LangSplat, eval/evaluate_iou_loc.py. Labelled frames are training views
there, and are knowledge views here too, as in prior art; `datasets.leakage` takes them out.
A frame is found by its name. LangSplat's evaluator takes the number in the name as an index into
the sorted renders, which is another picture as soon as one was not registered: where the two
disagree, a note says so.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from datasets.base import GroundTruth, SceneData
from datasets.camera_checks import is_folder
from datasets.capture import Capture, CaptureImage, read_capture
from datasets.frames import match_frame
from datasets.images import FORMATS, is_transparent
from datasets.lerf_labels import FrameLabels, read_frame_labels
from datasets.mask_folders import (
    Notes,
    camera_at_size,
    digests,
    entries,
    queries_for,
    view_names,
)
from datasets.picture_folder import picture_size
from datasets.provenance import is_original
from gvr_core.errors import DatasetError, unknown_name
from gvr_core.metrics import IN_SCENE_2D, REFUSAL
from gvr_core.picture_files import open_picture
from gvr_core.protocols.lerf_ovs import LANGSPLAT_2D, OPENGAUSSIAN_3D
from gvr_core.scene import Scene, View

NAME = "lerf_ovs"

SCENES = ("ramen", "figurines", "teatime", "waldo_kitchen")
"""The published scenes, in the order of the paper's tables."""

LABELS = "label"
"""Folder of the labels, beside the scenes."""

PICTURES = (".jpg", ".jpeg", ".png")
"""Endings of labelled pictures, in lower case, the one to take first."""


class LerfOvsDataset:
    """LERF-OVS on disk.

    Args:
        root: Holds ``label/`` and the scenes.
        splats: Folder of trained splats by scene; where None, each lies in its scene's folder.
    """

    name = NAME

    def __init__(self, root: Path, splats: Path | None = None) -> None:
        self._root = root
        self._splats = splats

    def scenes(self) -> Sequence[str]:
        """The published scenes that have a folder or labels, then others that have labels.

        A published scene whose labels or pictures are missing is listed: asking for it says what
        is missing, where leaving it out would change the mean over scenes unnoticed.

        Raises:
            DatasetError: if there is no scene, or no folder of labels.
        """
        if not is_folder(self._root / LABELS):
            raise DatasetError(
                f"no folder {LABELS}/ here",
                path=self._root,
                accepted=f"a folder with {LABELS}/ and the scenes {', '.join(SCENES)}",
            )
        labelled = [path.name for path in entries(self._root / LABELS) if _has_frames(path)]
        published = [name for name in SCENES if name in labelled or is_folder(self._root / name)]
        found = (*published, *(name for name in labelled if name not in SCENES))
        if not found:
            raise DatasetError(
                "no scene has labels",
                path=self._root / LABELS,
                accepted=f"a folder with label files for each of {', '.join(SCENES)}",
            )
        return found

    def load(self, scene: str) -> SceneData:
        """Read one scene.

        Raises:
            ConfigError: for a scene that is not there.
            DatasetError: for labels that are not as the layout says, a frame that is not
                registered, a labelled picture of another size, or what `read_capture` refuses.
            CameraFormatError: for cameras that cannot be used.
            SplatFormatError: for a splat that cannot be used.
        """
        scenes = self.scenes()
        if scene not in scenes:
            raise unknown_name(f"scene of {NAME}", scene, scenes)
        notes = Notes()
        labels = _read_labels(self._root / LABELS / scene, notes)
        capture = read_capture(self._root / scene, scene, splats=self._splats)
        frames = _frames(labels, capture, notes)
        names = view_names(capture.images, self._root / scene)
        knowledge = tuple(
            View(names[image.name], image.camera, image.path) for image in capture.images
        )
        tests = tuple(_test_view(image, names[image.name], frame, notes) for image, frame in frames)
        objects = tuple(dict.fromkeys(name for frame in labels for name in frame.masks))
        if not objects:
            raise DatasetError(
                "no frame has an object",
                path=self._root / LABELS / scene,
                accepted="one labelled object or more",
            )
        _note_alike(objects, notes)
        _note_extra(self._root, scenes, notes)
        queries = queries_for(objects)
        pairs = [
            (view.name, name, frame)
            for view, (_, frame) in zip(tests, frames, strict=True)
            for name in frame.masks
        ]
        return SceneData(
            Scene(NAME, scene, capture.gaussians, knowledge),
            queries,
            GroundTruth(
                objects,
                tests,
                {(view, name): frame.masks[name] for view, name, frame in pairs},
                boxes={(view, name): frame.boxes[name] for view, name, frame in pairs},
            ),
            digests(
                capture.ply,
                knowledge,
                queries,
                tests,
                objects,
                {(view.name, ""): f.path for view, (_, f) in zip(tests, frames, strict=True)},
            ),
            protocols=(LANGSPLAT_2D.id, OPENGAUSSIAN_3D.id, IN_SCENE_2D, REFUSAL),
            notes=(*capture.notes, *notes.lines()),
            original=is_original(self._root / scene, SCENES),
        )


def _has_frames(folder: Path) -> bool:
    return is_folder(folder) and any(path.suffix.lower() == ".json" for path in entries(folder))


def _read_labels(folder: Path, notes: Notes) -> list[FrameLabels]:
    """All label files of a scene, in name order, with their pictures checked."""
    if not is_folder(folder):
        raise DatasetError("missing folder", path=folder, accepted="the labels of the scene")
    found, pictures = [], []
    for path in entries(folder):
        if is_folder(path):
            notes.add("folders among the labels, left out", path.name)
        elif path.suffix.lower() == ".json":
            found.append(path)
        elif path.suffix.lower() in PICTURES:
            pictures.append(path)
        else:
            notes.add("files that are neither labels nor pictures, left out", path.name)
    if not found:
        raise DatasetError("no labels", path=folder, accepted="frame_XXXXX.json for each frame")
    for path in pictures:
        if path.stem not in {label.stem for label in found}:
            raise DatasetError(
                "a labelled picture without its labels",
                path=path,
                accepted=f"{path.stem}.json beside it",
            )
    labels = [read_frame_labels(path, notes) for path in found]
    for frame in labels:
        _check_picture(frame, notes)
    return labels


def _picture(frame: FrameLabels) -> Path | None:
    """The labelled picture beside a label file, where there is one."""
    beside = [path for path in entries(frame.path.parent) if path.stem == frame.path.stem]
    pictures = [path for path in beside if path.suffix.lower() in PICTURES]
    return min(pictures, key=lambda path: PICTURES.index(path.suffix.lower()), default=None)


def _check_picture(frame: FrameLabels, notes: Notes) -> None:
    """The labels are of a picture of the stated size."""
    path = _picture(frame)
    if path is None:
        notes.add("labelled frames without their picture, size taken as stated", frame.path.stem)
        return
    size = picture_size(path)
    if size != frame.size:
        raise DatasetError(
            f"the labels are of {frame.size[0]} x {frame.size[1]} pixels",
            path=frame.path,
            place="info",
            accepted=f"{size[0]} x {size[1]}, as {path.name} has",
        )
    with open_picture(path, FORMATS) as picture:
        if is_transparent(picture):
            notes.add("labelled pictures with an alpha channel, which is not looked at", path.name)


def _frames(
    labels: Sequence[FrameLabels], capture: Capture, notes: Notes
) -> list[tuple[CaptureImage, FrameLabels]]:
    """The registered image of each labelled frame."""
    order = [image.name for image in capture.images]
    meant: dict[str, Path] = {}
    frames = []
    for frame in labels:
        stem = frame.path.stem
        image = match_frame(
            capture.images, stem, unregistered=capture.unregistered, path=frame.path
        )
        if meant.setdefault(image.name, frame.path) != frame.path:
            raise DatasetError(
                f"the image {image.name!r} is labelled by {meant[image.name].name} already",
                path=frame.path,
                accepted="one label file for each image",
            )
        number = re.search(r"(\d+)$", stem)
        if number and order[int(number[1]) - 1 : int(number[1])] != [image.name]:
            notes.add("frames that an index into the sorted images would miss, found by name", stem)
        frames.append((image, frame))
    return frames


def _test_view(image: CaptureImage, name: str, frame: FrameLabels, notes: Notes) -> View:
    """The view of a labelled frame, with as many pixels as its labels."""
    camera = camera_at_size(image.camera, frame.size, frame.path, notes)
    own_size = frame.size == (image.camera.width, image.camera.height)
    picture = _picture(frame) or (image.path if own_size else None)
    return View(name, camera, picture)


def _note_alike(objects: Sequence[str], notes: Notes) -> None:
    """Categories that one thing seems to be called by, which every evaluator keeps apart."""
    seen: dict[str, str] = {}
    for name in objects:
        first = seen.setdefault(" ".join(name.lower().split()), name)
        if first != name:
            notes.add(
                "categories that differ only in case or spaces, kept apart", f"{first!r}, {name!r}"
            )


def _note_extra(root: Path, scenes: Sequence[str], notes: Notes) -> None:
    for path in (*entries(root), *entries(root / LABELS)):
        if is_folder(path) and path.name not in (*scenes, LABELS):
            notes.add("folders without labels, left out", path.relative_to(root).as_posix())
