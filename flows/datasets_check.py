"""``gvr datasets check``: can a folder be read, and what is in it?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from datasets.base import Dataset, SceneData
from datasets.cameras_file import has_cameras
from datasets.capture import CapturedImages, read_capture, read_images
from datasets.recognise import CAPTURE, EXPECTED, NATIVE, Recognised, recognise
from datasets.registry import FOLDER, get_dataset
from flows.datasets_commands import names
from flows.exit_codes import EXIT_BAD_INPUT
from flows.output import complain, print_document, say
from gvr_core.errors import ConfigError, InputError, unknown_name


@dataclass(frozen=True)
class CheckedScene:
    """One scene that was read, or why it could not be."""

    name: str
    folder: Path
    error: str | None = None
    gaussians: int | None = None
    """Null, as all counts, where nothing could be counted."""
    splat: Path | None = None
    """Of a capture: the splat that was found."""
    views: int | None = None
    pictures: int | None = None
    """Views with a picture."""
    test_views: int | None = None
    objects: int | None = None
    pairs: int | None = None
    """(test view, object) pairs."""
    labelled: int | None = None
    """Of the pairs."""
    queries: int | None = None
    protocols: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    """Repairs that reading needed."""


@dataclass(frozen=True)
class CheckDocument:
    """A folder that was read as a layout."""

    path: Path
    layout: str
    because: str
    expected: tuple[str, ...] | None
    """Scenes that papers report; null where there are none or a single scene was asked for."""
    missing: tuple[str, ...] | None
    scenes: tuple[CheckedScene, ...]


def datasets_check(
    path: Path,
    layout: str | None = None,
    splats: Path | None = None,
    splat: Path | None = None,
    as_json: bool = False,
) -> int:
    """``gvr datasets check``: read a folder as the layout it looks like.

    One scene that cannot be read does not keep the others from being read.

    Args:
        path: A data set's folder, or a scene of one.
        layout: The layout, where the folder looks like several.
        splats: Folder of trained splats by scene.
        splat: Trained splat of a capture.
        as_json: Print a document, in place of lines.

    Returns:
        Exit code: 0, or 2 where a scene could not be read.

    Raises:
        DatasetError: for no folder, or one that looks like no data set.
        ConfigError: for a layout that it does not look like, or several and none named.
    """
    chosen = _chosen(recognise(path), path, layout)
    first = chosen[0]
    if splat is not None and first.layout != CAPTURE:
        raise ConfigError("--splat names the splat of a single capture", accepted="--splats")
    expected = missing = None
    if first.layout == CAPTURE:
        scenes = _captures(chosen, splat, splats, not as_json)
    else:
        dataset = _dataset(first, splats)
        there = tuple(dataset.scenes())
        if first.layout in EXPECTED and first.scene is None:
            expected = tuple(EXPECTED[first.layout])
            missing = tuple(name for name in expected if name not in there)
        if not as_json:
            say(f"{path}: {first.layout}, by {first.because}")
            say(f"found: {names(there)}")
            if expected is not None and missing is not None:
                say(f"expected: {names(expected)}")
                say(f"missing: {names(missing)}")
        wanted = there if first.scene is None else (first.scene,)
        scenes = _labelled(dataset, first.root, wanted, not as_json)
    read = []
    for scene in scenes:
        read.append(scene)
        if scene.error is not None:
            complain(f"{scene.name}: {scene.error}")
    if as_json:
        document = CheckDocument(path, first.layout, first.because, expected, missing, tuple(read))
        print_document("datasets check", document)
    return EXIT_BAD_INPUT if any(scene.error is not None for scene in read) else 0


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


def _labelled(
    dataset: Dataset, root: Path, scenes: Sequence[str], aloud: bool
) -> Iterator[CheckedScene]:
    """Read scenes with truth, one after the other, and say what is in each."""
    for scene in scenes:
        folder = root / scene if (root / scene).is_dir() else root
        try:
            data = dataset.load(scene)
        except InputError as error:
            yield CheckedScene(scene, folder, str(error))
            continue
        found = _counted(scene, folder, data)
        if aloud:
            say(f"{scene}: {_described(found)}")
            _say_notes(found.notes)
        yield found


def _counted(scene: str, folder: Path, data: SceneData) -> CheckedScene:
    truth, views = data.truth, data.scene.views
    pairs = [(view, name) for view in truth.test_views for name in truth.objects]
    return CheckedScene(
        name=scene,
        folder=folder,
        gaussians=len(data.scene.gaussians),
        views=len(views),
        pictures=sum(view.image is not None for view in views),
        test_views=len(truth.test_views),
        objects=len(truth.objects),
        pairs=len(pairs),
        labelled=sum(truth.is_labelled(view, name) for view, name in pairs),
        queries=len(data.queries),
        protocols=tuple(data.protocols),
        notes=tuple(data.notes),
    )


def _described(scene: CheckedScene) -> str:
    return (
        f"{scene.gaussians} Gaussians, {scene.views} views ({scene.pictures} with a picture),"
        f" {scene.test_views} test views, {scene.objects} objects, {scene.labelled} of"
        f" {scene.pairs} pairs labelled, {scene.queries} queries; scored by"
        f" {', '.join(scene.protocols)}"
    )


def _captures(
    items: Sequence[Recognised], splat: Path | None, splats: Path | None, aloud: bool
) -> Iterator[CheckedScene]:
    """Read captures, cameras first: they may be right where there is no splat."""
    for item in items:
        name = item.scene or item.root.resolve().name
        if aloud:
            say(f"{item.root}: {CAPTURE}, by {item.because}")
        views = pictures = None
        notes: tuple[str, ...] = ()
        try:
            captured = read_images(item.root)
            views = len(captured.images)
            pictures = sum(image.path is not None for image in captured.images)
            notes = captured.notes
            if aloud:
                _say_images(name, captured, pictures)
            capture = read_capture(item.root, name, splat, splats)
        except InputError as error:
            yield CheckedScene(
                name, item.root, str(error), views=views, pictures=pictures, notes=notes
            )
            continue
        count = len(capture.gaussians)
        if aloud:
            say(f"{name}: {count} Gaussians from {capture.ply}")
            _say_notes([note for note in capture.notes if note not in notes])
        yield CheckedScene(
            name=name,
            folder=item.root,
            gaussians=count,
            splat=capture.ply,
            views=views,
            pictures=pictures,
            notes=capture.notes,
        )


def _say_images(name: str, captured: CapturedImages, pictures: int) -> None:
    say(
        f"{name}: {len(captured.images)} registered images ({pictures} with a picture), cameras"
        f" from {names(str(path) for path in captured.camera_files)}"
    )
    if captured.unregistered:
        say(
            f"  {len(captured.unregistered)} pictures without a camera:"
            f" {names(captured.unregistered[:3])}"
        )
    _say_notes(captured.notes)


def _say_notes(notes: Sequence[str]) -> None:
    for note in notes:
        say(f"  note: {note}")
