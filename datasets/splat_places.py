"""Where the trained splat of a scene lies: by convention, or where a setting says.

Looked for in this order of description; several that differ are refused::

    <scene>/point_cloud/iteration_N/point_cloud.ply          largest N; inria's trainer
    <scene>/output/point_cloud/iteration_N/point_cloud.ply   the same, trained into output/
    <scene>/output/<name>/point_cloud/iteration_N/...        LangSplat's README
    <scene>/<name>.ply, <scene>/point_cloud.ply, and the same in output/

``input.ply`` and COLMAP's points are no trained splats and are never taken.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from datasets.camera_checks import is_file, is_folder
from gvr_core.atomic import file_digest
from gvr_core.errors import DatasetError, some_of

POINT_CLOUD = "point_cloud"
_ITERATION = re.compile(r"iteration_(\d+)")
_NAMED = "or one named by the setting splat, or in the folder that the setting splats names"


def find_splat(
    folder: Path, scene: str, splat: Path | None = None, splats: Path | None = None
) -> Path:
    """The splat file of a scene.

    Args:
        folder: The scene's folder.
        scene: The scene's name.
        splat: The file, or its training's output folder, where it is named: from the scene's
            folder where it is there, else from the working directory. Nothing else is looked at.
        splats: A folder of splats where that is named: ``<scene>.ply`` in it, or
            ``<scene>/`` with one as above. Nothing else is looked at.

    Raises:
        DatasetError: if there is none, or several whose content differs.
    """
    if splat is not None:
        return _named(folder, Path(splat), scene)
    if splats is not None:
        splats = Path(splats)
        if not is_folder(splats):
            raise DatasetError("no folder of splats here", path=splats, accepted="a folder")
        places = [splats / f"{scene}.ply", *_places(splats / scene, scene)]
        wanted = f"{scene}.ply, or {scene}/point_cloud/iteration_N/point_cloud.ply"
        return _one(places, splats, wanted)
    wanted = f"point_cloud/iteration_N/point_cloud.ply here or in output/, {scene}.ply, {_NAMED}"
    return _one(_places(folder, scene), folder, wanted)


def model_folder(ply: Path) -> Path | None:
    """The output folder of the training that a splat is from, where its path tells."""
    inner = ply.parent.parent
    if _ITERATION.fullmatch(ply.parent.name) and inner.name == POINT_CLOUD:
        return inner.parent
    return None


def _named(folder: Path, splat: Path, scene: str) -> Path:
    """The splat that a setting names."""
    for path in (folder / splat, splat):
        if is_file(path):
            return path
        if is_folder(path):
            wanted = (
                f"a splat file, or point_cloud/iteration_N/point_cloud.ply or {scene}.ply in it"
            )
            return _one(_places(path, scene), path, wanted)
    raise DatasetError(
        "no such splat", path=folder / splat, accepted="a .ply or .splat file, or a folder with one"
    )


def _places(folder: Path, scene: str) -> list[Path]:
    """Every place in a scene's folder where a splat may lie, whether it does or not."""
    outputs = (folder, folder / "output", folder / "output" / scene)
    newest = [path for output in outputs if (path := _newest(output / POINT_CLOUD)) is not None]
    plain = [o / f"{name}.ply" for o in outputs[:2] for name in dict.fromkeys((scene, POINT_CLOUD))]
    return newest + plain


def _newest(folder: Path) -> Path | None:
    """The splat of the most iterations among inria's; folders without a splat do not count."""
    found = []
    for path in folder.glob(f"iteration_*/{POINT_CLOUD}.ply"):
        number = _ITERATION.fullmatch(path.parent.name)
        if number and is_file(path):
            found.append((int(number.group(1)), path))
    return max(found)[1] if found else None


def _one(places: Iterable[Path], folder: Path, wanted: str) -> Path:
    """The splat among the places; several with one content count as one."""
    found = [path for path in places if is_file(path)]
    if not found:
        raise DatasetError("no trained splat", path=folder, accepted=wanted)
    if len({path.stat().st_size for path in found}) > 1 or (
        len(found) > 1 and len({file_digest(path) for path in found}) > 1
    ):
        listed = some_of((str(path.relative_to(folder)) for path in found), most=6)
        raise DatasetError(
            f"several splats that differ: {listed}",
            path=folder,
            accepted="one of them, named by the setting splat",
        )
    return found[0]
