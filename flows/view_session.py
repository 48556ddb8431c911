"""A scene that questions are asked of, one after the other; no browser in it."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from pathlib import Path

from datasets.base import SceneData
from datasets.own import own_scene
from flows.progress import Progress
from flows.scene_setup import load_scene, make_job
from flows.suite import DatasetChoice
from gvr_core.books import Books
from gvr_core.errors import ConfigError
from gvr_core.methods import Grounding, Method, MethodConfig, build_method
from gvr_core.models.registry import ModelConfig
from gvr_core.scene import Query
from tasks.stages import prepared_books
from tasks.store import Store

LONGEST_TEXT = 400


@dataclass(frozen=True, eq=False)
class Asked:
    """A question and its answer."""

    text: str
    grounding: Grounding
    seconds: float
    """Wall time of the answer."""


class ViewSession:
    """Books of a scene, and a method that answers from them.

    Args:
        data: The scene.
        method: Answers.
        books: What preparation knows of the scene.
    """

    def __init__(self, data: SceneData, method: Method, books: Books) -> None:
        self.data = data
        self.method = method
        self.books = books
        self._one_at_a_time = threading.Lock()
        self._asked = 0

    def ask(self, text: str) -> Asked:
        """Ground a text in the scene.

        Args:
            text: 1 to 400 characters.

        Raises:
            ConfigError: for a text that is empty or too long.
            ModelError: if a model cannot answer.
        """
        text = text.strip()
        if not 0 < len(text) <= LONGEST_TEXT:
            raise ConfigError(
                f"a text of {len(text)} characters", accepted=f"1 to {LONGEST_TEXT} characters"
            )
        with self._one_at_a_time:
            self._asked += 1
            query = Query(id=f"view{self._asked}", text=text)
            start = time.perf_counter()
            grounding = self.method.ground(self.data.scene, self.books, query)
            return Asked(text, grounding, time.perf_counter() - start)


def open_scene(scene: str, cameras: Path | None, max_views: int | None) -> SceneData:
    """The scene that the command line names.

    Args:
        scene: A splat file, or ``DATASET/SCENE``.
        cameras: The splat file's cameras; None for a data set's scene.
        max_views: Use only so many cameras of a splat file; None for all.

    Raises:
        ConfigError: for a name that is neither, or cameras beside a data set's scene.
        InputError: for files that cannot be read.
    """
    accepted = "a .ply or .splat file with --cameras, or DATASET/SCENE such as gallery/gallery_0"
    if cameras is not None:
        return own_scene(scene, cameras, (), max_views)
    if Path(scene).suffix.lower() in (".ply", ".splat"):
        raise ConfigError(f"{scene}: whose cameras?", accepted=accepted)
    dataset, _, name = scene.rpartition("/")
    if not dataset or not name:
        raise ConfigError(f"the scene {scene!r}", accepted=accepted)
    return load_scene(DatasetChoice(name=dataset), name)


def start_session(
    data: SceneData, method: str, models: ModelConfig, store: Path | str, progress: bool = False
) -> ViewSession:
    """Prepare a scene, from the store where it has been prepared before.

    Args:
        data: The scene.
        method: Name of the method that answers.
        models: Which models.
        store: Root of the artifact store.
        progress: Show progress bars.

    Raises:
        ConfigError: for a method that is not known.
        ModelError: for weights that are missing or wrong.
    """
    with Progress(shown=progress) as bars:
        job = make_job(data, MethodConfig(method=method), Store(store), models, progress=bars)
        books = prepared_books(job)
    return ViewSession(data, build_method(job.method, job.tools), books)
