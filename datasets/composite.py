"""The composites: real splats at known places, so that labels and masks are exact.

Captured objects, synthetic arrangement; reports have to say so. A layout file says what stands
where (`datasets.layout`). Two sets of them come with the package: three composites, in which
nothing is out of the ordinary, and ten stress scenes, in which one thing each is.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from datasets.base import SceneData
from datasets.composing import compose
from datasets.layout import Layout, read_layout
from datasets.making import RENDERER, made_once, recipe_digest, slug, take_pictures
from datasets.native import read_scene, write_scene
from datasets.photographs import PHOTOGRAPHS
from gvr_core.atomic import file_digest
from gvr_core.errors import DatasetError, unknown_name
from gvr_core.rendering.base import get_renderer
from gvr_core.scene import Query

VERSION = 1
"""Raised whenever the same layout and splats make another scene."""

LAYOUTS = Path(__file__).parent / "layouts"
"""The layouts of the composites that come with the package."""
STRESS_LAYOUTS = LAYOUTS / "stress"
"""The layouts of the stress scenes: each makes one thing hard (see `docs/stress_scenes.md`)."""

COMPOSITE, STRESS = "composite", "stress"
"""Names of the two data sets that are made from layouts."""


class CompositeDataset:
    """One scene for each layout file, made on first use.

    Args:
        root: Folder to keep the scenes in. A scene is made again when its layout, one of its
            splats or the generator's version changes.
        splats: Folder with the splats; see `splats_folder` for where None looks.
        layouts: Folder of layout files; a scene has the name of its file.
        name: Name of the data set.
    """

    def __init__(
        self,
        root: Path = Path(".gvr/data/composite"),
        splats: Path | None = None,
        layouts: Path = LAYOUTS,
        name: str = COMPOSITE,
    ) -> None:
        self.name = name
        self._root = root
        self._splats = splats
        self._layouts = {path.stem: path for path in sorted(layouts.glob("*.toml"))}

    def scenes(self) -> Sequence[str]:
        """Names of the scenes, in alphabetical order.

        Raises:
            DatasetError: if there is no folder of splats: a run ends before it begins.
        """
        splats_folder(self._splats)
        return tuple(self._layouts)

    def load(self, scene: str) -> SceneData:
        """Read one scene; the first time, make it.

        Raises:
            ConfigError: for a scene that has no layout.
            DatasetError: if the layout is not valid, or a splat is missing.
            SplatFormatError: for a splat that cannot be used.
        """
        if scene not in self._layouts:
            raise unknown_name(f"scene of {self.name}", scene, self._layouts)
        layout = read_layout(self._layouts[scene])
        files = {name: _splat(self._splats, name) for name in layout.splats()}
        digests = {name: file_digest(path) for name, path in files.items()}
        renderer = get_renderer(RENDERER)
        recipe = recipe_digest(
            self.name, VERSION, renderer.name, layout.model_dump(mode="json"), digests
        )
        folder = self._root / scene

        def make() -> None:
            make_scene(folder, scene, layout, files, recipe, self.name)

        made_once(folder, recipe, make)
        return read_scene(folder, self.name, scene)


def splats_folder(given: Path | None = None) -> Path:
    """Where the real splats lie.

    In this order: the folder given, ``GVR_SPLATS``, ``data/splats`` in ``GVR_SHARED``, and
    ``shared/data/splats`` next to the checkout.

    Raises:
        DatasetError: if the first of these that is set is no folder.
    """
    if given is None and os.environ.get("GVR_SPLATS"):
        given = Path(os.environ["GVR_SPLATS"])
    if given is None:
        beside = Path(__file__).resolve().parent.parent.parent / "shared"
        given = Path(os.environ.get("GVR_SHARED") or beside) / "data" / "splats"
    if not given.is_dir():
        raise DatasetError(
            "no folder of splats here",
            path=given,
            accepted="a folder named by the setting, by GVR_SPLATS, or data/splats in GVR_SHARED",
        )
    return given


def make_scene(
    folder: Path,
    name: str,
    layout: Layout,
    files: Mapping[str, Path],
    recipe: str = "",
    dataset: str = COMPOSITE,
) -> None:
    """Make one scene on disk, in the native layout.

    Args:
        folder: Where; an older scene there is replaced.
        name: The scene's name.
        layout: What stands where.
        files: Where each splat file of the layout lies.
        recipe: Kept in the scene, to tell whether it is up to date.
        dataset: Name of the data set that it belongs to.

    Raises:
        SplatFormatError: for a splat that cannot be used.
        DatasetError: for a splat without height, or of which nothing is kept.
    """
    made = compose(layout, files)
    tests = tuple(view for view in made.cameras if view.startswith("test_"))
    write_scene(
        folder,
        dataset=dataset,
        name=name,
        gaussians=made.gaussians,
        pictures=take_pictures(
            get_renderer(RENDERER), made.gaussians, made.labels, made.objects, made.cameras, tests
        ),
        objects=made.objects,
        labels=made.labels,
        queries=queries(layout),
        up=made.up if layout.states_up else None,
        provenance=provenance(layout),
        recipe=recipe,
        replace=True,
    )


def queries(layout: Layout) -> tuple[Query, ...]:
    """Every wording of every object, and the absent ones."""
    present = [
        Query(id=f"{slug(item.name)}-{i}", text=text, target=item.name)
        for item in layout.objects
        for i, text in enumerate(item.queries, start=1)
    ]
    absent = [
        Query(id=f"absent-{i}", text=item.text, absent=True)
        for i, item in enumerate(layout.absent, start=1)
    ]
    return (*present, *absent)


def provenance(layout: Layout) -> str:
    """Whose splats and photographs a scene shows."""
    shown = [photo for photo in PHOTOGRAPHS if photo.name in layout.photographs()]
    kinds = "real splats and photographs" if shown else "real splats"
    sources = "".join(f" {photo.name}: {photo.source}, {photo.licence}." for photo in shown)
    return f"{kinds}, synthetic arrangement. {layout.licence}{sources}"


def _splat(folder: Path | None, name: str) -> Path:
    """A splat's file, which must be there."""
    path = splats_folder(folder) / name
    if not path.is_file():
        raise DatasetError("missing splat", path=path)
    return path
