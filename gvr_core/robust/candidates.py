"""Candidates: the patches that may be the object, and where their surfaces lie in 3D."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gvr_core.books import DepthBook, PatchBook
from gvr_core.cameras import Camera
from gvr_core.localize import depths_at
from gvr_core.robust.surfaces import inner_depths, middle_of, pixels_near
from gvr_core.run_lengths import cropped, patch_positions
from gvr_core.scene import View

BoolArray = NDArray[np.bool_]
Float64Array = NDArray[np.float64]

NEUTRAL = 0.5
"""Relevancy of a patch that is as much like the query as like anything else."""
TIE_MARGIN = 0.02
"""Relevancies in one step of this size count as equal; then the whole goes before its parts."""
OVERLAP = 0.5
"""Two patches of a view are the same thing where this part of the smaller lies in the other."""
ERODE = 0.2
"""A patch is eroded by this part of the radius of a disc of its area: depth is least certain at
an outline."""
MAD_LIMIT = 3.0
"""Depths further from the median than this many (scaled) median deviations are not the object's."""
DEPTH_SLACK = 0.02
"""Depths within this fraction of the median always are."""
SAMPLES = 256
"""Points kept of each candidate's surface."""
RADIUS_PERCENTILE = 90.0
"""A candidate's radius is this percentile of its points' distances from their middle."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A patch that may be the object."""

    view: int
    """Index of its view."""
    patch: int
    """Index in the patch book."""
    relevancy: float
    pixel: tuple[float, float]
    """L_2D: (x, y), pixels."""
    surface: Float64Array
    """(s, 3) points of what it shows, world frame, s >= 1."""
    point: Float64Array
    """(3,) L_3D of this view: the middle of the surface."""
    radius: float
    """Scene units."""

    @property
    def evidence(self) -> float:
        """What it says for the place: its relevancy above 0.5, where a patch is like anything."""
        return max(self.relevancy - NEUTRAL, 0.0)


def gated_patches(
    scores: NDArray[np.float32], patches: PatchBook, threshold: float, coarsest_only: bool = False
) -> list[int]:
    """The patches above a threshold, each thing of a view once.

    Args:
        scores: (M,) relevancies.
        patches: The M patches.
        threshold: A patch must score more.
        coarsest_only: Look at the coarsest level of each view alone.

    Returns:
        Indices into the book, by view; within a view the most relevant first, and of equally
        relevant ones the largest.
    """
    chosen: list[int] = []
    above = np.flatnonzero(scores > threshold)
    for view in np.unique(np.searchsorted(patches.view_ptr, above, side="right") - 1):
        inside = _patches_of(patches, int(view), coarsest_only)
        inside = inside[scores[inside] > threshold]
        steps = np.floor(scores[inside] / TIE_MARGIN)
        taken: list[int] = []
        for j in inside[np.lexsort((inside, -patches.areas[inside], -steps))]:
            if not any(_same_thing(patches, int(j), other) for other in taken):
                taken.append(int(j))
        chosen += taken
    return chosen


def best_of_each_view(
    scores: NDArray[np.float32], patches: PatchBook, coarsest_only: bool = False
) -> list[int]:
    """The most relevant patch of every view, however little it says; the paper's retrieval."""
    chosen = []
    for view in range(patches.n_views):
        inside = _patches_of(patches, view, coarsest_only)
        if len(inside):
            chosen.append(int(inside[np.argmax(scores[inside])]))
    return chosen


def place_candidate(
    patch: int,
    relevancy: float,
    patches: PatchBook,
    depths: DepthBook,
    views: Sequence[View],
    median_depth: bool = True,
) -> Candidate | None:
    """Where a patch's surface lies; None where it has no depth.

    Args:
        patch: Index in the book.
        relevancy: Its relevancy.
        patches: The patches.
        depths: B_d.
        views: The knowledge views.
        median_depth: Depth is the median over the eroded patch, and what deviates is left out;
            else the expected depth at the patch's position stands for all of it.
    """
    view = patches.view_of(patch)
    camera = views[view].camera
    if not median_depth:
        return _by_position(view, patch, relevancy, patches, depths, camera)
    pixels, (x0, y0) = cropped(patches, patch)
    height, width = pixels.shape
    depth = depths.depth(view, "median")[y0 : y0 + height, x0 : x0 + width]
    depth = np.ascontiguousarray(depth, np.float32)
    core = inner_depths(pixels, eroded(pixels), depth)
    if len(core) == 0:
        return None
    middle = np.median(core)
    deviation = 1.4826 * float(np.median(np.abs(core - middle)))
    limit = max(MAD_LIMIT * deviation, DEPTH_SLACK * float(middle))
    found = pixels_near(pixels, depth, middle, np.float32(limit), SAMPLES)
    xy = found[:, ::-1] + np.array([x0 + 0.5, y0 + 0.5])
    surface = camera.unproject(xy, depth[found[:, 0], found[:, 1]])
    nearest, radius = middle_of(surface, RADIUS_PERCENTILE)
    pixel = (float(xy[nearest, 0]), float(xy[nearest, 1]))
    return Candidate(view, patch, relevancy, pixel, surface, surface[nearest], radius)


def eroded(pixels: BoolArray) -> BoolArray:
    """A mask (H, W) without its outline; the depth of the erosion follows its size."""
    steps = max(1, round(ERODE * float(np.sqrt(np.count_nonzero(pixels) / np.pi))))
    framed = np.pad(pixels, 1).astype(np.uint8)
    away = cv2.distanceTransform(framed, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(away[1:-1, 1:-1] > steps)


def _patches_of(patches: PatchBook, view: int, coarsest_only: bool) -> NDArray[np.int64]:
    """Indices of a view's patches, or of those of its coarsest level."""
    inside = np.arange(patches.view_ptr[view], patches.view_ptr[view + 1])
    if coarsest_only and len(inside):
        inside = inside[patches.levels[inside] == patches.levels[inside].max()]
    return inside


def _by_position(
    view: int,
    patch: int,
    relevancy: float,
    patches: PatchBook,
    depths: DepthBook,
    camera: Camera,
) -> Candidate | None:
    pixels = patch_positions(patches, np.array([patch]))
    z = float(depths_at(depths, np.array([view]), pixels)[0])
    if z <= 0:
        return None
    x, y = float(pixels[0, 0]), float(pixels[0, 1])
    point = camera.unproject((x, y), z)
    focal = float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
    radius = float(np.sqrt(patches.areas[patch] / np.pi)) * z / focal
    return Candidate(view, patch, relevancy, (x, y), point[None], point, radius)


def _same_thing(patches: PatchBook, a: int, b: int) -> bool:
    """Whether two patches of a view overlap so much that they are the same thing."""
    smaller = float(min(patches.areas[a], patches.areas[b]))
    low = np.maximum(patches.boxes[a][:2], patches.boxes[b][:2])
    high = np.minimum(patches.boxes[a][2:], patches.boxes[b][2:])
    # what the boxes share bounds what the patches share, and costs no decoding
    if np.maximum(high - low, 0).prod() <= OVERLAP * smaller:
        return False
    parts = []
    for patch in (a, b):
        pixels, (x0, y0) = cropped(patches, patch)
        parts.append(pixels[low[1] - y0 : high[1] - y0, low[0] - x0 : high[0] - x0])
    return bool(np.count_nonzero(parts[0] & parts[1]) > OVERLAP * smaller)
