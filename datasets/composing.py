"""From a layout to Gaussians, labels and cameras: what stands where, put together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.layout import Layout
from datasets.layout_objects import FlatTable, PhotographTable, SplatTable, about_z
from datasets.layout_room import FloatersTable, GroundTable, SurfaceTable
from datasets.layout_tables import TextureTable
from datasets.photographs import PHOTOGRAPHS, RGB8, read_photograph, read_texture, wood
from datasets.surfaces import box, rectangle
from gvr_core.cameras import Camera
from gvr_core.errors import DatasetError
from gvr_core.gaussians import SH_C0, Gaussians
from gvr_core.splat_io import read_splat
from gvr_core.transforms import transform_gaussians


@dataclass(frozen=True, eq=False)
class Composition:
    """A scene before it is drawn."""

    gaussians: Gaussians
    labels: NDArray[np.int16]
    """(N,) index into ``objects``, -1 for the ground and all that has no name."""
    objects: tuple[str, ...]
    cameras: dict[str, Camera]
    """All views by name, the test views last."""
    up: tuple[float, float, float]
    """True up direction, world frame, whether or not the scene states it."""


def compose(layout: Layout, files: Mapping[str, Path]) -> Composition:
    """Everything of a scene but its pictures.

    Args:
        layout: What stands where.
        files: Where each splat file of the layout lies.

    Raises:
        SplatFormatError: for a splat that cannot be used.
        DatasetError: for a splat without height, or of which nothing is kept.
    """
    parts, labels = [], []
    for index, item in enumerate(layout.objects):
        for part in _instances(item, files):
            parts.append(part)
            labels.append(np.full(len(part), index, np.int16))
    room = [
        *_uncovered(ground(layout.ground), layout),
        *(surface(table) for table in layout.surfaces),
    ]
    if layout.floaters is not None:
        room.append(floaters(layout.floaters))
    parts += room
    labels += [np.full(len(part), -1, np.int16) for part in room]
    gaussians, cameras = Gaussians.concatenate(parts), layout.cameras.cameras()
    up = (0.0, 0.0, 1.0)
    if layout.world is not None:
        gaussians = layout.world.move(gaussians)
        cameras = {name: layout.world.move_camera(camera) for name, camera in cameras.items()}
        x, y, z = layout.world.rotation[:, 2].tolist()
        up = (x, y, z)
    return Composition(
        gaussians,
        np.concatenate(labels),
        tuple(item.name for item in layout.objects),
        cameras,
        up,
    )


def _uncovered(plane: Gaussians, layout: Layout) -> list[Gaussians]:
    """The ground without what lies under flat things; no set where they cover all of it.

    Gaussians are sorted by their centres: at a low angle those of the ground would show through a
    layer that lies closely above them.
    """
    kept = np.ones(len(plane), np.bool_)
    for item in layout.objects:
        if isinstance(item, FlatTable):
            for at in item.places():
                own = (plane.means[:, :2] - np.asarray(at.position)) @ about_z(at.yaw)[:2, :2]
                kept &= (np.abs(own) > np.asarray(item.size) / 2).any(axis=1)
    return [plane.subset(kept)] if kept.any() else []


def _instances(
    item: SplatTable | PhotographTable | FlatTable, files: Mapping[str, Path]
) -> list[Gaussians]:
    """Every instance of a thing, on its place."""
    if isinstance(item, SplatTable):
        path = files[item.file]
        return place(read_splat(path), item, path)
    if isinstance(item, PhotographTable):
        photograph = next(p for p in PHOTOGRAPHS if p.name == item.photograph)
        thing = box(item.size, read_photograph(photograph), None, item.pitch)
    else:
        width, depth = item.size
        thing = _lying(width, depth, item)
    return [
        transform_gaussians(thing, about_z(at.yaw), (*at.position, item.lift))
        for at in item.places()
    ]


def place(gaussians: Gaussians, item: SplatTable, path: Path) -> list[Gaussians]:
    """A splat on its places: upright, turned, as tall as wanted, standing on the ground.

    Args:
        gaussians: The splat in its own frame.
        item: Where it goes.
        path: Its file, for the message.

    Returns:
        Its instances, each with as many Gaussians.

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
    placed = []
    for at in item.places():
        rotation = item.upright(at.yaw)
        turned = gaussians.means.astype(np.float64) @ rotation.T
        # single floaters decide neither the size nor where the ground is
        low, high = np.percentile(turned, [1, 99], axis=0)
        height = float(high[2] - low[2])
        if height <= 0:
            raise DatasetError("the splat is flat along its up direction", path=path)
        scale = item.height / height
        middle = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
        move = np.array([*at.position, item.lift]) - scale * middle
        placed.append(transform_gaussians(gaussians, rotation, move, scale))
    return placed


def ground(table: GroundTable) -> Gaussians:
    """The textured plane at z = 0."""
    width, depth = table.size
    return _lying(width, depth, table)


def surface(table: SurfaceTable) -> Gaussians:
    """A textured rectangle where its table says."""
    return rectangle(table.corner, table.right, table.down, _texture(table), table.pitch)


def floaters(table: FloatersTable) -> Gaussians:
    """Blobs in the air, each of another place, shape, colour and opacity.

    Returns:
        Gaussians without view-dependent colour: as many as the table says, the same for the same
        table.
    """
    rng = np.random.default_rng(table.seed)
    n = table.count
    quats = rng.normal(size=(n, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    colours = rng.uniform(0, 1, (n, 1, 3))
    return Gaussians(
        rng.uniform(table.lower, table.upper, (n, 3)).astype(np.float32),
        rng.uniform(*table.size, (n, 3)).astype(np.float32),
        quats.astype(np.float32),
        rng.uniform(*table.opacity, n).astype(np.float32),
        ((colours - 0.5) / SH_C0).astype(np.float32),
    )


def _lying(width: float, depth: float, table: TextureTable) -> Gaussians:
    """A textured rectangle at z = 0 around the origin."""
    x, y, _ = np.eye(3)
    corner = (-width / 2, depth / 2, 0)
    return rectangle(corner, width * x, -depth * y, _texture(table), table.pitch)


def _texture(table: TextureTable) -> RGB8:
    """The picture of a textured rectangle, (h, w, 3) uint8."""
    if table.texture == "wood":
        texture = wood(np.random.default_rng(0), table.tint)
    else:
        texture = read_texture(table.texture, table.tint, table.contrast)
    return np.tile(texture, (table.repeat, table.repeat, 1))
