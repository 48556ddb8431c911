"""The composites: real splats at known places, so that labels and masks are exact.

Captured objects, synthetic arrangement; reports have to say so. A layout file says what stands
where (`datasets.layout`); three come with the package.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from datasets.base import SceneData
from datasets.layout import GroundTable, Layout, ObjectTable, read_layout
from datasets.making import RENDERER, made_once, recipe_digest, slug, take_pictures
from datasets.native import read_scene, write_scene
from datasets.photographs import read_texture, wood
from datasets.surfaces import rectangle
from gvr_core.atomic import file_digest
from gvr_core.errors import DatasetError, unknown_name
from gvr_core.gaussians import Gaussians
from gvr_core.rendering.base import get_renderer
from gvr_core.scene import Query
from gvr_core.splat_io import read_splat
from gvr_core.transforms import transform_gaussians

VERSION = 1
"""Raised whenever the same layout and splats make another scene."""

LAYOUTS = Path(__file__).parent / "layouts"
"""The layouts that come with the package."""


class CompositeDataset:
    """One scene for each layout file, made on first use.

    Args:
        root: Folder to keep the scenes in. A scene is made again when its layout, one of its
            splats or the generator's version changes.
        splats: Folder with the splats; see `splats_folder` for where None looks.
        layouts: Folder of layout files; a scene has the name of its file.
    """

    name = "composite"

    def __init__(
        self,
        root: Path = Path(".gvr/data/composite"),
        splats: Path | None = None,
        layouts: Path = LAYOUTS,
    ) -> None:
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
            raise unknown_name("scene of composite", scene, self._layouts)
        layout = read_layout(self._layouts[scene])
        files = {item.file: _splat(self._splats, item.file) for item in layout.objects}
        digests = {name: file_digest(path) for name, path in files.items()}
        renderer = get_renderer(RENDERER)
        recipe = recipe_digest(
            "composite", VERSION, renderer.name, layout.model_dump(mode="json"), digests
        )
        folder = self._root / scene

        def make() -> None:
            make_scene(folder, scene, layout, files, recipe)

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
    folder: Path, name: str, layout: Layout, files: dict[str, Path], recipe: str = ""
) -> None:
    """Make one scene on disk, in the native layout.

    Args:
        folder: Where; an older scene there is replaced.
        name: The scene's name.
        layout: What stands where.
        files: Where each splat file of the layout lies.
        recipe: Kept in the scene, to tell whether it is up to date.

    Raises:
        SplatFormatError: for a splat that cannot be used.
        DatasetError: for a splat without height, or of which nothing is kept.
    """
    parts = [place(read_splat(files[item.file]), item, files[item.file]) for item in layout.objects]
    plane = ground(layout.ground)
    gaussians = Gaussians.concatenate([*parts, plane])
    counts = [len(part) for part in parts] + [len(plane)]
    labels = np.repeat(np.array([*range(len(parts)), -1], np.int16), counts)
    objects = tuple(item.name for item in layout.objects)
    cameras = layout.cameras.cameras()
    tests = tuple(view for view in cameras if view.startswith("test_"))
    write_scene(
        folder,
        dataset="composite",
        name=name,
        gaussians=gaussians,
        pictures=take_pictures(get_renderer(RENDERER), gaussians, labels, objects, cameras, tests),
        objects=objects,
        labels=labels,
        queries=queries(layout),
        up=(0.0, 0.0, 1.0),
        provenance=f"real splats, synthetic arrangement. {layout.licence}",
        recipe=recipe,
        replace=True,
    )


def place(gaussians: Gaussians, item: ObjectTable, path: Path) -> Gaussians:
    """A splat on its place: upright, turned, as tall as wanted, standing on the ground.

    Args:
        gaussians: The splat in its own frame.
        item: Where it goes.
        path: Its file, for the message.

    Raises:
        DatasetError: if nothing is kept of it, or it has no height.
    """
    if item.keep_within is not None:
        low, high = (np.asarray(corner, np.float32) for corner in item.keep_within)
        inside = (gaussians.means >= low) & (gaussians.means <= high)
        kept = np.asarray(inside.all(axis=1))
        if not kept.any():
            raise DatasetError(
                "no Gaussian lies inside keep_within", path=path, accepted="a larger box"
            )
        gaussians = gaussians.subset(kept)
    rotation = item.upright()
    turned = gaussians.means.astype(np.float64) @ rotation.T
    # single floaters decide neither the size nor where the ground is
    low, high = np.percentile(turned, [1, 99], axis=0)
    height = float(high[2] - low[2])
    if height <= 0:
        raise DatasetError("the splat is flat along its up direction", path=path)
    scale = item.height / height
    middle = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    move = np.array([*item.position, item.lift]) - scale * middle
    return transform_gaussians(gaussians, rotation, move, scale)


def ground(table: GroundTable) -> Gaussians:
    """The textured plane at z = 0."""
    if table.texture == "wood":
        texture = wood(np.random.default_rng(0), table.tint)
    else:
        texture = read_texture(table.texture, table.tint, table.contrast)
    texture = np.tile(texture, (table.repeat, table.repeat, 1))
    width, depth = table.size
    x, y, _ = np.eye(3)
    return rectangle((-width / 2, depth / 2, 0), width * x, -depth * y, texture, table.pitch)


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


def _splat(folder: Path | None, name: str) -> Path:
    """A splat's file, which must be there."""
    path = splats_folder(folder) / name
    if not path.is_file():
        raise DatasetError("missing splat", path=path)
    return path
