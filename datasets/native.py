"""The project's own layout of a scene: trained splat, views, exact masks, labels and queries.

::

    <scene>/
      scene.json                     name, up direction, objects, test views, provenance
      queries.json                   a list of queries
      labels.npy                     (N,) int16: index into the objects, -1 for the rest
      point_cloud/iteration_30000/point_cloud.ply
      sparse/0/{cameras,images,points3D}.txt      COLMAP: all views
      images/<view>.png              one picture for each view
      test_masks/<view>/<object>.png an object that the view does not show has none

Views without masks are the knowledge views. Splat, views and model lie where 3D Gaussian
Splatting (graphdeco-inria/gaussian-splatting) puts them, so other tools read a scene as well.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datasets.base import GroundTruth, SceneData
from datasets.camera_checks import is_file, is_folder
from datasets.colmap import read_colmap_model
from datasets.digests import digest_of, view_parts
from datasets.images import read_mask
from datasets.native_records import (
    MODEL,
    PLY,
    check_distinct,
    check_name,
    read_labels,
    read_queries,
    read_scene_file,
)
from datasets.native_writer import Picture, write_scene
from gvr_core.atomic import file_digest
from gvr_core.errors import DatasetError
from gvr_core.picture_files import open_picture
from gvr_core.scene import Scene, View
from gvr_core.splat_io import read_ply

__all__ = ["Picture", "read_recipe", "read_scene", "write_scene"]

FORMATS = ("PNG", "JPEG")
"""What the pictures of a scene may be, by Pillow's names; the writer makes PNG."""


def read_scene(folder: Path, dataset: str | None = None, name: str | None = None) -> SceneData:
    """Read a scene, and check that everything in it fits together.

    Args:
        folder: The scene's folder.
        dataset: Name of the data set in tables; the one that the scene states where None.
        name: Name of the scene in tables; the one that the scene states where None.

    Raises:
        DatasetError: for a missing file or picture, a picture that is not as large as its
            camera says, an unknown view, object, target or key, labels or masks that do not
            fit, or queries with one id.
        CameraFormatError: for a COLMAP model that cannot be used.
        SplatFormatError: for a splat that cannot be used.
    """
    if not is_folder(folder):
        raise DatasetError("no such folder", path=folder, accepted="the folder of a scene")
    record = read_scene_file(folder / "scene.json")
    queries = read_queries(folder / "queries.json", record.objects)
    for path in (PLY, Path("labels.npy"), MODEL / "cameras.txt", MODEL / "images.txt"):
        if not is_file(folder / path):
            raise DatasetError("missing file", path=folder / path)
    views = _read_views(folder)
    for index, view in enumerate(record.test_views):
        if view not in views:
            raise DatasetError(
                f"unknown view {view!r}",
                path=folder / "scene.json",
                place=f"test_views[{index}]",
                accepted=", ".join(views),
            )
    knowledge = tuple(view for n, view in views.items() if n not in record.test_views)
    if not knowledge:
        raise DatasetError(
            "every view is a test view",
            path=folder / "scene.json",
            place="test_views",
            accepted="one view or more without masks",
        )
    test_views = tuple(view for n, view in views.items() if n in record.test_views)
    gaussians = read_ply(folder / PLY)
    labels = read_labels(folder / "labels.npy", len(gaussians), len(record.objects))
    masks = _find_masks(folder / "test_masks", test_views, record.objects)
    up = None if record.up is None else np.asarray(record.up) / np.linalg.norm(record.up)
    return SceneData(
        Scene(dataset or record.dataset, name or record.name, gaussians, knowledge, up),
        queries,
        GroundTruth(record.objects, test_views, masks, labels),
        {
            "gaussians": file_digest(folder / PLY),
            "views": digest_of(
                [
                    "" if up is None else up.tobytes().hex(),
                    *(view_parts(view, True) for view in knowledge),
                ]
            ),
            "queries": file_digest(folder / "queries.json"),
            "truth": digest_of(
                [
                    repr(record.objects),
                    file_digest(folder / "labels.npy"),
                    *(view_parts(view, False) for view in test_views),
                    *(f"{view}/{target}:{file_digest(p)}" for (view, target), p in masks.items()),
                ]
            ),
        },
    )


def read_recipe(folder: Path) -> str | None:
    """The recipe of a scene on disk; None where there is no scene that can be read."""
    try:
        return read_scene_file(folder / "scene.json").recipe
    except DatasetError:
        return None


def _read_views(folder: Path) -> dict[str, View]:
    """The views of the COLMAP model, with their pictures, in name order."""
    views = {}
    cameras = read_colmap_model(folder / MODEL).cameras
    names = {image: image.rpartition(".")[0] for image in cameras}
    check_distinct(list(names.values()), "view", folder / MODEL)
    for image, camera in cameras.items():
        name = check_name(names[image], "view", folder / MODEL, image)
        path = folder / "images" / image
        size = _picture_size(path)
        if size != (camera.width, camera.height):
            raise DatasetError(
                f"the picture has {size[0]} x {size[1]} pixels",
                path=path,
                accepted=f"{camera.width} x {camera.height}, as its camera has",
            )
        views[name] = View(name, camera, path)
    return views


def _picture_size(path: Path) -> tuple[int, int]:
    """Width and height of a picture, from its header."""
    if not is_file(path):
        raise DatasetError("the COLMAP model has a camera, but there is no picture", path=path)
    with open_picture(path, FORMATS) as picture:
        return picture.size


def _find_masks(
    folder: Path, test_views: tuple[View, ...], objects: tuple[str, ...]
) -> dict[tuple[str, str], Path]:
    """The masks on disk, by view and object: nothing that is not known, each read once."""
    known = {view.name: view for view in test_views}
    masks = {}
    for place in sorted(folder.iterdir()) if is_folder(folder) else ():
        if place.name not in known:
            raise DatasetError("masks of an unknown view", path=place, accepted=", ".join(known))
        if not is_folder(place):
            raise DatasetError("this is no folder", path=place, accepted="a folder of masks")
        camera = known[place.name].camera
        for path in sorted(place.iterdir()):
            if path.suffix != ".png" or path.stem not in objects:
                raise DatasetError(
                    "a mask of an unknown object",
                    path=path,
                    accepted=", ".join(f"{name}.png" for name in objects),
                )
            read_mask(path, size=(camera.width, camera.height))
            masks[place.name, path.stem] = path
    return masks
