"""Writing a scene in the layout of 3D-OVS (see `datasets.ovs3d`)."""

from __future__ import annotations

from pathlib import Path

from datasets.base import SceneData
from datasets.exporting import Shot, new_folder, prompts, write_capture
from datasets.images import write_png
from datasets.native_records import check_distinct
from datasets.provenance import mark_export
from gvr_core.atomic import atomic_write
from gvr_core.errors import DatasetError
from gvr_core.rendering.base import Renderer


def export_ovs3d(data: SceneData, root: Path, renderer: Renderer) -> Path:
    """Write one scene as a tree of 3D-OVS, with the scene's own exact masks.

    Views keep their names; a test view's masks lie in the folder of its number among all
    pictures in name order, every class in every folder, black where the view does not show it.
    What the layout has no room for is left behind: labels in 3D, the up direction, further
    wordings, queries for what is absent, and which views were held out.

    Args:
        data: The scene.
        root: Folder of the data set; gets a folder of the scene's name.
        renderer: Draws the views that have no picture.

    Returns:
        The scene's folder; it appears whole or not at all.

    Raises:
        DatasetError: if the folder is there already, there is no test view or no object, a
            view's name is a number or taken, or an object has no text that can be a file name.
        CameraFormatError: for a view name that COLMAP cannot hold.
        OSError: if a file cannot be written.
    """
    folder = root / data.scene.name
    tests = {view.name: view for view in data.truth.test_views}
    if not tests or not data.truth.objects:
        raise DatasetError(
            f"{len(tests)} test views, {len(data.truth.objects)} objects",
            path=folder,
            accepted="one or more of each",
        )
    views = {view.name: view for view in data.scene.views} | tests
    check_distinct(list(views), "view", folder)
    for name in views:
        if name.isdecimal():
            raise DatasetError(
                f"the view name {name!r} would be read as a number among the pictures",
                path=folder,
                accepted="names with a letter",
            )
    shots = sorted((Shot(name, view) for name, view in views.items()), key=lambda shot: shot.file)
    texts = prompts(data)
    with new_folder(folder) as temporary:
        write_capture(temporary, data.scene.gaussians, shots, renderer)
        mark_export(temporary, data)
        segmentations = temporary / "segmentations"
        for index, shot in enumerate(shots):
            if shot.stem in tests:
                for target, text in texts.items():
                    path = segmentations / f"{index:02d}" / f"{text}.png"
                    write_png(path, data.truth.mask(shot.view, target))
        with atomic_write(segmentations / "classes.txt") as stream:
            stream.writelines(f"{text}\n".encode() for text in sorted(texts.values()))
    return folder
