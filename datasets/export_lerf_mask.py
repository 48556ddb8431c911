"""Writing a scene in the layout of LERF-Mask (see `datasets.lerf_mask`)."""

from __future__ import annotations

from pathlib import Path

from datasets.base import SceneData
from datasets.exporting import Shot, new_folder, prompts, write_capture, write_photograph
from datasets.images import write_png
from datasets.native_records import check_distinct
from datasets.provenance import mark_export
from gvr_core.errors import DatasetError
from gvr_core.rendering.base import Renderer


def export_lerf_mask(data: SceneData, root: Path, renderer: Renderer) -> Path:
    """Write one scene as a tree of LERF-Mask, with the scene's own exact masks.

    Knowledge views keep their names and lie in ``images/`` and ``images_train/``; test views
    become ``test_0``, ``test_1``, ... in their order, with leading zeros where there are more
    than ten. An object that a test view does not show has no mask there, and a view that shows
    none has no folder. What the layout has no room for is left behind: labels in 3D, the up
    direction, further wordings, queries for what is absent.

    Args:
        data: The scene; its test views are not among its knowledge views.
        root: Folder of the data set; gets a folder of the scene's name.
        renderer: Draws the views that have no picture.

    Returns:
        The scene's folder; it appears whole or not at all.

    Raises:
        DatasetError: if the folder is there already, no test view shows an object, a test view
            is a knowledge view as well, a name is taken, or an object has no text that can be a
            file name.
        CameraFormatError: for a view name that COLMAP cannot hold.
        OSError: if a file cannot be written.
    """
    folder = root / data.scene.name
    tests = data.truth.test_views
    digits = len(str(max(len(tests) - 1, 0)))
    train = [Shot(view.name, view) for view in data.scene.views]
    held_out = [Shot(f"test_{i:0{digits}d}", view) for i, view in enumerate(tests)]
    both = sorted({view.name for view in tests} & {shot.stem for shot in train})
    if both:
        raise DatasetError(
            f"the test view {both[0]!r} is a knowledge view as well",
            path=folder,
            accepted="a scene that holds its test views out",
        )
    check_distinct([shot.stem for shot in (*train, *held_out)], "view", folder)
    texts = prompts(data)
    with new_folder(folder) as temporary:
        write_capture(temporary, data.scene.gaussians, [*train, *held_out], renderer)
        mark_export(temporary, data)
        for shot in train:
            path = temporary / "images_train" / shot.file
            write_photograph(path, data.scene.gaussians, shot.view, renderer)
        written = 0
        for index, view in enumerate(tests):
            for target, text in texts.items():
                mask = data.truth.mask(view, target)
                if mask.any():
                    write_png(temporary / "test_mask" / str(index) / f"{text}.png", mask)
                    written += 1
        if not written:
            raise DatasetError(
                "no test view shows an object", path=folder, accepted="one mask or more"
            )
    return folder
