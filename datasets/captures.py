"""Captures of one's own: a trained splat and cameras each, and questions; no ground truth.

What is asked stands in the suite and not beside the scenes, whose folders are other tools'. Answers
come with a picture each; there is nothing to score them by.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from datasets.base import GroundTruth, SceneData
from datasets.camera_checks import is_folder
from datasets.cameras_file import has_cameras
from datasets.capture import read_capture
from datasets.digests import digest_of, view_parts
from datasets.mask_folders import view_names
from datasets.own import at_most, own_queries
from gvr_core.atomic import file_digest
from gvr_core.errors import ConfigError, DatasetError, unknown_name
from gvr_core.metrics import REFUSAL
from gvr_core.scene import Scene, View

CAPTURES = "captures:"
"""Names that begin with this are folders of captures."""


class CapturesDataset:
    """Captures, as they lie in a folder.

    Args:
        folder: A folder of captures, or a single one.
        queries: Scene -> the texts to ask; a scene that is left out does not take part. None for
            all scenes, with nothing asked: to look at them.

    Raises:
        ConfigError: for queries that cannot be asked, or that name no scene of the folder.
        DatasetError: if there is no capture in it.
    """

    def __init__(self, folder: Path, queries: object = None) -> None:
        self.name = CAPTURES + str(folder)
        self._folders = capture_folders(folder)
        if not self._folders:
            raise DatasetError(
                "no capture here",
                path=folder,
                accepted="a folder that holds cameras and a trained splat, or folders that do",
            )
        self._queries = dict.fromkeys(self._folders, ()) if queries is None else _asked(queries)
        for scene in self._queries:
            if scene not in self._folders:
                raise unknown_name(f"scene of {self.name}", scene, self._folders)

    def scenes(self) -> Sequence[str]:
        """Names of the scenes' folders, in alphabetical order: those that something is asked of."""
        return tuple(scene for scene in self._folders if scene in self._queries)

    def load(self, scene: str) -> SceneData:
        """Read one scene.

        Returns:
            Views are at most `datasets.own.MAX_SIDE` pixels large, and all are looked at.

        Raises:
            ConfigError: for a scene that is not in the folder.
            DatasetError: for no splat, or one that does not fit the cameras.
            CameraFormatError: for cameras that cannot be used.
            SplatFormatError: for a splat that cannot be used.
        """
        if scene not in self._folders:
            raise unknown_name("scene", scene, self._folders)
        folder = self._folders[scene]
        capture = read_capture(folder, scene)
        names = view_names(capture.images, folder)
        views = tuple(View(names[i.name], at_most(i.camera)) for i in capture.images)
        texts = self._queries.get(scene, ())
        return SceneData(
            Scene(self.name, scene, capture.gaussians, views),
            own_queries(texts),
            GroundTruth(objects=(), test_views=()),
            {
                "gaussians": file_digest(capture.ply),
                "views": digest_of(view_parts(view, False) for view in views),
                "queries": digest_of(texts),
                "truth": digest_of(()),
            },
            (REFUSAL,),
            capture.notes,
        )


def capture_folders(folder: Path) -> dict[str, Path]:
    """The captures of a folder by name: itself, or those directly in it that hold cameras.

    Scenes in the project's own layout hold cameras too, and are none.

    Raises:
        DatasetError: if it is no folder, or cannot be listed.
    """
    if not is_folder(folder):
        raise DatasetError("no such folder", path=folder, accepted="a folder of captures")
    try:
        inside = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError as error:
        raise DatasetError(f"cannot be listed: {error.strerror}", path=folder) from error
    if has_cameras(folder):
        return {folder.resolve().name: folder}
    found = [path for path in inside if is_folder(path) and has_cameras(path)]
    return {path.name: path for path in found if not (path / "scene.json").exists()}


def _asked(queries: object) -> Mapping[str, Sequence[str]]:
    """What the setting ``queries`` says, checked."""
    place, accepted = "captures.settings.queries", 'a table: scene = ["a text", "another"]'
    if not isinstance(queries, Mapping):
        raise ConfigError(f"queries {queries!r}"[:100], place=place, accepted=accepted)
    for scene, texts in queries.items():
        listed = isinstance(texts, (list, tuple)) and all(isinstance(t, str) for t in texts)
        if not listed or not texts or len(set(texts)) < len(texts):
            raise ConfigError(
                f"{texts!r}"[:100],
                place=f"{place}.{scene}",
                accepted="a list of different texts, one or more",
            )
        own_queries(texts)
    return queries
