"""The query path said slowly: whole pictures, one view after the other, all pairs at once.

The oracles of the fast ways in ``gvr_core``: plain numpy over everything there is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gvr_core.books import DepthBook, PatchBook
from gvr_core.cameras import Camera
from gvr_core.gaussians import Gaussians
from gvr_core.models.base import Frame
from gvr_core.robust.candidates import (
    DEPTH_SLACK,
    ERODE,
    MAD_LIMIT,
    OVERLAP,
    RADIUS_PERCENTILE,
    SAMPLES,
    Candidate,
)
from gvr_core.robust.clusters import WEISZFELD_STEPS
from gvr_core.robust.observation import DEPTH_SLACK as SEEN_SLACK
from gvr_core.robust.observation import LEAST_VIEWS, POINTS
from gvr_core.scene import Scene, View

BoolArray = NDArray[np.bool_]
Float64Array = NDArray[np.float64]


def patch_position(pixels: NDArray[np.bool_]) -> tuple[float, float]:
    rows, columns = np.nonzero(pixels)
    offset = (rows - rows.mean()) ** 2 + (columns - columns.mean()) ** 2
    nearest = int(np.argmin(offset))
    return float(columns[nearest]) + 0.5, float(rows[nearest]) + 0.5


def best_patches(
    scores: NDArray[np.float32], view_ptr: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    views = np.flatnonzero(np.diff(view_ptr) > 0)
    best = [view_ptr[i] + int(np.argmax(scores[view_ptr[i] : view_ptr[i + 1]])) for i in views]
    return views, np.array(best, dtype=np.int64)


def vote(points: Float64Array, radius: float) -> NDArray[np.bool_]:
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    near = distances <= radius
    votes = near.sum(axis=1)
    spread = np.where(near, distances, 0.0).sum(axis=1)
    winner = int(np.lexsort((spread, -votes))[0])
    voters: NDArray[np.bool_] = near[winner]
    return voters


def frustum_filter(gaussians: Gaussians, camera: Camera, mask: BoolArray) -> BoolArray:
    pixels, z = camera.project(gaussians.means)
    with np.errstate(invalid="ignore"):
        columns, rows = np.floor(pixels[:, 0]), np.floor(pixels[:, 1])
        inside = (z > 0) & (columns >= 0) & (columns < camera.width)
        inside &= (rows >= 0) & (rows < camera.height)
    flags = np.zeros(len(gaussians), dtype=np.bool_)
    flags[inside] = mask[rows[inside].astype(np.int64), columns[inside].astype(np.int64)]
    return flags


def place_candidate(
    patch: int,
    relevancy: float,
    patches: PatchBook,
    depths: DepthBook,
    views: Sequence[View],
    median_depth: bool = True,
) -> Candidate | None:
    view = patches.view_of(patch)
    pixels, camera = patches.pixels(patch), views[view].camera
    if not median_depth:
        x, y = patch_position(pixels)
        z = float(depths.depth(view)[int(y), int(x)])
        if z <= 0:
            return None
        point = camera.unproject((x, y), z)
        focal = float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
        reach = float(np.sqrt(np.count_nonzero(pixels) / np.pi)) * z / focal
        return Candidate(view, patch, relevancy, (x, y), point[None], point, reach)
    depth = depths.depth(view, "median")
    core = eroded(pixels) & (depth > 0)
    if not core.any():
        core = pixels & (depth > 0)
        if not core.any():
            return None
    middle = float(np.median(depth[core]))
    deviation = 1.4826 * float(np.median(np.abs(depth[core] - middle)))
    limit = max(MAD_LIMIT * deviation, DEPTH_SLACK * middle)
    rows, columns = np.nonzero(pixels & (depth > 0) & (np.abs(depth - middle) <= limit))
    if len(rows) > SAMPLES:
        kept = np.linspace(0, len(rows) - 1, SAMPLES).astype(np.int64)
        rows, columns = rows[kept], columns[kept]
    xy = np.stack([columns, rows], axis=1) + 0.5
    surface = camera.unproject(xy, depth[rows, columns])
    centre = np.median(surface, axis=0)
    distances = np.linalg.norm(surface - centre, axis=1)
    nearest = int(np.argmin(distances))
    radius = float(np.percentile(distances, RADIUS_PERCENTILE))
    pixel = (float(xy[nearest, 0]), float(xy[nearest, 1]))
    return Candidate(view, patch, relevancy, pixel, surface, surface[nearest], radius)


def eroded(pixels: BoolArray) -> BoolArray:
    steps = max(1, round(ERODE * float(np.sqrt(np.count_nonzero(pixels) / np.pi))))
    inside: BoolArray = ndimage.distance_transform_edt(np.pad(pixels, 1))[1:-1, 1:-1] > steps
    return inside


def same_thing(patches: PatchBook, a: int, b: int) -> bool:
    smaller = float(min(patches.areas[a], patches.areas[b]))
    low = np.maximum(patches.boxes[a][:2], patches.boxes[b][:2])
    high = np.minimum(patches.boxes[a][2:], patches.boxes[b][2:])
    # what the boxes share bounds what the patches share, and costs no decoding
    if np.maximum(high - low, 0).prod() <= OVERLAP * smaller:
        return False
    shared = np.count_nonzero(patches.pixels(a) & patches.pixels(b))
    return bool(shared > OVERLAP * smaller)


def observed_share(
    scene: Scene,
    depths: DepthBook,
    bev: Frame,
    mask: NDArray[np.bool_],
    most_degrees: float,
) -> float:
    rows, columns = np.nonzero(mask & (bev.depth > 0))
    if len(rows) == 0:
        return 0.0
    kept = np.linspace(0, len(rows) - 1, min(POINTS, len(rows))).astype(np.int64)
    rows, columns = rows[kept], columns[kept]
    xy = np.stack([columns, rows], axis=1) + 0.5
    points = bev.camera.unproject(xy, bev.depth[rows, columns])
    down = points - bev.camera.position
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    least = np.cos(np.radians(most_degrees))
    seen = np.zeros(len(points), np.int64)
    for i, view in enumerate(scene.views):
        camera = view.camera
        towards = points - camera.position
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        pixels, z = camera.project(points)
        inside = (z > 0) & (np.einsum("pi,pi->p", towards, down) >= least)
        with np.errstate(invalid="ignore"):
            inside &= (pixels[:, 0] >= 0) & (pixels[:, 0] < camera.width)
            inside &= (pixels[:, 1] >= 0) & (pixels[:, 1] < camera.height)
        at = np.floor(pixels[inside]).astype(np.int64)
        depth = depths.depth(i, "median")[at[:, 1], at[:, 0]]
        seen[inside] += (depth > 0) & (depth >= (1 - SEEN_SLACK) * z[inside])
    return float((seen >= LEAST_VIEWS).mean())


def geometric_median(points: Float64Array) -> Float64Array:
    centre: Float64Array = np.median(points, axis=0)
    scale = float(np.abs(points - centre).max())
    for _ in range(WEISZFELD_STEPS):
        weights = 1 / np.maximum(np.linalg.norm(points - centre, axis=1), 1e-6 * scale + 1e-300)
        moved = weights @ points / weights.sum()
        if np.linalg.norm(moved - centre) <= 1e-6 * scale:
            return np.asarray(moved, np.float64)
        centre = moved
    return centre
