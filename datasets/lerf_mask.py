"""LERF-Mask: three LERF scenes with masks of text prompts in held-out views.

::

    <root>/<scene>/
      images/, sparse/0/, the trained splat     (see `datasets.capture`)
      images_train/                  the training images' names; what is not there is a test image
      test_mask/<index>/<prompt>.png

The index counts the test images in name order; some have no masks. The layout and the split are
those of Gaussian Grouping (lkeab/gaussian-grouping: docs/dataset.md, scene/dataset_readers.py,
script/eval_lerf_mask.py).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath

from datasets.base import GroundTruth, SceneData
from datasets.camera_checks import is_file, is_folder
from datasets.capture import Capture, CaptureImage, read_capture
from datasets.frames import match_frame
from datasets.mask_folders import (
    Notes,
    camera_at_size,
    check_mask,
    check_text,
    digests,
    entries,
    find_scenes,
    mask_files,
    mask_folders,
    note_extra_folders,
    queries_for,
    scene_folder,
    view_names,
)
from datasets.mask_sources import GreyMask
from datasets.native_records import check_distinct
from datasets.provenance import is_original
from gvr_core.errors import DatasetError, some_of
from gvr_core.metrics import IN_SCENE_2D, REFUSAL
from gvr_core.scene import Scene, View

LERF_MASK = "lerf_mask"

PROTOCOLS = ("lerf_mask.gg/1", "lerf_mask.gg_compat/1", IN_SCENE_2D, REFUSAL)

PROMPTS: Mapping[str, tuple[str, ...]] = {
    "figurines": (
        "green apple",
        "green toy chair",
        "old camera",
        "porcelain hand",
        "red apple",
        "red toy chair",
        "rubber duck with red hat",
    ),
    "ramen": (
        "chopsticks",
        "egg",
        "glass of water",
        "pork belly",
        "wavy noodles in bowl",
        "yellow bowl",
    ),
    "teatime": (
        "apple",
        "bag of cookies",
        "coffee mug",
        "cookies on a plate",
        "paper napkin",
        "plate",
        "sheep",
        "spoon handle",
        "stuffed bear",
        "tea in a glass",
    ),
}
"""The prompts of the published scenes, as render_lerf_mask.py lists them."""

THRESHOLD = 128
"""Foreground is brighter than this, of 0 to 255."""

MASKS, TRAIN = "test_mask", "images_train"

FOLDERS = (
    *("images", "images_2", "images_4", "images_8", TRAIN, MASKS, "object_mask", "raw_object_mask"),
    *("input", "sparse", "distorted", "stereo", "point_cloud", "output", "train", "test"),
)
"""Folders that the data set and the tools around it make in a scene."""


class LerfMaskDataset:
    """The scenes of LERF-Mask.

    Args:
        root: Holds a folder for each scene; or is itself one.
        splats: Folder of the trained splats, where they do not lie with the scenes.
    """

    name = LERF_MASK

    def __init__(self, root: Path, splats: Path | None = None) -> None:
        self._root = root
        self._splats = splats

    def scenes(self) -> Sequence[str]:
        """Names of the scenes that are there: figurines, ramen, teatime, then others.

        Raises:
            DatasetError: if there is none.
        """
        return tuple(find_scenes(self._root, tuple(PROMPTS), MASKS))

    def load(self, scene: str) -> SceneData:
        """Read one scene. Methods see the training images alone.

        Returns:
            A test view is as large as its masks. Prompts are queries and objects in one.

        Raises:
            ConfigError: for a scene that is not there.
            DatasetError: for a missing folder, no training or no test image, masks of a view
                that is no test view or has no camera, a prompt that is there twice, or a mask
                that cannot be used.
            CameraFormatError: for cameras that cannot be used.
            SplatFormatError: for a splat that cannot be used.
        """
        scenes = find_scenes(self._root, tuple(PROMPTS), MASKS)
        folder = scene_folder(self.name, scenes, scene, MASKS)
        capture = read_capture(folder, scene, splats=self._splats)
        notes = Notes()
        names = view_names(capture.images, folder)
        train, tests = _split(folder, capture, notes)
        knowledge = tuple(View(names[i.name], i.camera, i.path) for i in train)
        test_views, masks = _read_masks(folder / MASKS, train, tests, capture, names, notes)
        objects = tuple(sorted({prompt for _, prompt in masks}))
        check_distinct(objects, "prompt", folder / MASKS)
        _compare_prompts(scene, objects, notes)
        note_extra_folders(folder, FOLDERS, notes)
        queries = queries_for(objects)
        paths = {key: mask.path for key, mask in masks.items()}
        return SceneData(
            Scene(self.name, scene, capture.gaussians, knowledge),
            queries,
            GroundTruth(objects, test_views, masks),
            digests(capture.ply, knowledge, queries, test_views, objects, paths),
            PROTOCOLS,
            (*capture.notes, *notes.lines()),
            is_original(folder, PROMPTS),
        )


def _split(
    folder: Path, capture: Capture, notes: Notes
) -> tuple[list[CaptureImage], list[CaptureImage]]:
    """Training and test images, each in name order."""
    images = sorted(capture.images, key=lambda image: _stem(image.name))
    if is_folder(folder / TRAIN):
        stems = {path.stem for path in entries(folder / TRAIN) if is_file(path)}
        for stem in sorted(stems - {_stem(image.name) for image in images}):
            notes.add(f"pictures in {TRAIN}/ without a camera, left out", stem)
        rule = f"a name in {TRAIN}/ for some of the images, not for all"
    else:
        stems = {_stem(i.name) for i in images if not _stem(i.name).startswith("test_")}
        notes.add(f"folder {TRAIN}/ missing, images named test_* are the test images", folder.name)
        rule = f"{TRAIN}/, or images named test_* and others"
    train = [image for image in images if _stem(image.name) in stems]
    tests = [image for image in images if _stem(image.name) not in stems]
    if not train or not tests:
        raise DatasetError(
            f"{len(train)} training images and {len(tests)} test images",
            path=folder / TRAIN,
            accepted=rule,
        )
    return train, tests


def _read_masks(
    folder: Path,
    train: Sequence[CaptureImage],
    tests: Sequence[CaptureImage],
    capture: Capture,
    names: Mapping[str, str],
    notes: Notes,
) -> tuple[tuple[View, ...], dict[tuple[str, str], GreyMask]]:
    """The test views that have masks, in name order, and their masks by (view, prompt)."""
    sizes: dict[str, tuple[int, int]] = {}
    places: dict[str, Path] = {}
    masks: dict[tuple[str, str], GreyMask] = {}
    for place in mask_folders(folder, notes):
        files = mask_files(place, notes)
        if not files:
            notes.add(f"folders in {MASKS}/ without masks, left out", place.name)
            continue
        image = _test_image(place, train, tests, capture)
        view = names[image.name]
        if view in places:
            raise DatasetError(
                f"holds masks of the view {view!r}, as {places[view].name}/ does",
                path=place,
                accepted="one folder for each test view",
            )
        places[view] = place
        prompts = {path: check_text(path.name.split(".")[0], path) for path in files}
        check_distinct([prompt.strip() for prompt in prompts.values()], "prompt", place)
        size = None
        for path, prompt in prompts.items():
            size = check_mask(path, THRESHOLD, range(THRESHOLD + 1, 256), size, notes)
            masks[view, prompt] = GreyMask(path, size, THRESHOLD)
            sizes[view] = size
    if not masks:
        raise DatasetError("no mask", path=folder, accepted="<index>/<prompt>.png")
    views = []
    for image in tests:
        view = names[image.name]
        if view in places:
            camera = camera_at_size(image.camera, sizes[view], places[view], notes)
            views.append(View(view, camera, image.path))
    return tuple(views), masks


def _test_image(
    place: Path,
    train: Sequence[CaptureImage],
    tests: Sequence[CaptureImage],
    capture: Capture,
) -> CaptureImage:
    """The test image that a folder of masks belongs to: by number, else by name."""
    name = place.name
    accepted = f"0 to {len(tests) - 1}, which count {some_of(image.name for image in tests)}"
    if not (name.isascii() and name.isdecimal()):
        image = match_frame(capture.images, name, unregistered=capture.unregistered, path=place)
        if any(image is other for other in train):
            raise DatasetError(f"{image.name!r} is a training image", path=place, accepted=accepted)
        return image
    if int(name) >= len(tests):
        raise DatasetError(f"there is no test image {int(name)}", path=place, accepted=accepted)
    image = tests[int(name)]
    # A test image that is missing moves all later ones to the index of their neighbour.
    alike = {str(int(name)), f"test_{int(name)}"}
    for other in (*(test.name for test in tests), *capture.unregistered):
        head, _, digits = _stem(other).rpartition("_")
        number = str(int(digits)) if digits.isascii() and digits.isdecimal() else digits
        if other != image.name and (f"{head}_{number}" if head else number) in alike:
            raise DatasetError(
                f"the folder means {image.name!r} by its index, and {other!r} by its name",
                path=place,
                accepted="an index and a name that agree; is a test image without a camera?",
            )
    return image


def _compare_prompts(scene: str, objects: Sequence[str], notes: Notes) -> None:
    """Note where a scene has not the prompts that it is known for."""
    published = PROMPTS.get(scene)
    if published is None:
        return
    for prompt in published:
        if prompt not in objects:
            notes.add(f"of {len(published)} published prompts without a mask", prompt)
    for prompt in objects:
        if prompt not in published:
            notes.add("prompts that the published scene does not have", prompt)


def _stem(name: str) -> str:
    return PurePosixPath(name).stem
