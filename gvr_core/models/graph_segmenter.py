"""Patches without a learnt model: graph-based segmentation of colour and depth."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from skimage.color import rgb2lab
from skimage.segmentation import felzenszwalb

from gvr_core.models.base import BoolArray, Frame, Mask
from gvr_core.models.frame_geometry import FrameGeometry, frame_geometry
from gvr_core.models.frame_memory import content_key
from gvr_core.models.outlines import Outline, outline_of
from gvr_core.models.regions import LabelArray, Region, regions_of
from gvr_core.models.things import merge_things
from gvr_core.threads import available_threads

_REMEMBERED = 4
"""Frames whose masks are kept: prompts come in a row for one picture."""


_BOX_MARGIN = 0.1
"""Boxes whose overlaps with a prompt differ by less than this are equally good."""


class GraphSettings(BaseModel):
    """Settings of the graph-based segmenter; none has a unit, so none depends on the scene."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    min_share: float = Field(default=0.0015, gt=0, lt=1)
    """Masks smaller than this share of the picture are dropped."""
    max_masks: int = Field(default=48, ge=1)
    """At most so many masks a frame; coarse and large ones are kept first."""
    same_iou: float = Field(default=0.9, gt=0, le=1)
    """Of two masks that overlap more than this, the coarser one is kept."""
    colour_scales: tuple[float, ...] = (600.0,)
    """k of the graph-based segmentation of Lab / 100, times 255 as scikit-image has it; finest
    first. Colour never joins what depth keeps apart."""
    geometry_scales: tuple[float, ...] = (3000.0,)
    """The same for disparity and support planes: surfaces. Colour has no say there, so that
    things with a busy pattern stay whole."""
    gap_limit: float = Field(default=0.75, ge=0)
    """Surfaces whose gap in depth is less than this part of their size make one thing."""
    min_score: float = Field(default=0.8, ge=0, le=1)
    """Masks that geometry closes less than this are left out of the automatic ones: pieces that
    only colour sets apart. Prompts still find them. 0 keeps all, say for pictures on a wall; and
    all are kept where the others cover less than half of what is shown."""
    object_share: float = Field(default=0.7, gt=0, le=1)
    """A point prompt takes nothing larger than this share of the picture for a thing."""
    point_slack: float = Field(default=0.015, ge=0, le=0.2)
    """A point may miss a thing by this fraction of the picture's shorter side."""


@dataclass(frozen=True, eq=False)
class _Proposal:
    """A mask, and what its outline runs along."""

    mask: Mask
    outline: Outline

    @property
    def is_thing(self) -> bool:
        return self.outline.stands >= 0.5 and self.outline.on_plane < 0.5


class GraphSegmenter:
    """Graph-based segmentation of colour and depth, at several scales.

    Felzenszwalb and Huttenlocher, "Efficient Graph-Based Image Segmentation" (IJCV 2004), run by
    scikit-image. Levels, from fine to coarse: patches of like colour; surfaces, by disparity and
    support planes alone, so that they come out whole however busy their pattern is; things, by
    joining surfaces that are near each other in depth. A finer level never crosses a border of
    the surfaces. A mask's score is the share of its outline that runs along a geometric edge
    (:attr:`Outline.closed`), or 1 for all in a frame without depth.

    Args:
        settings: Scales and limits.
    """

    def __init__(self, settings: GraphSettings | None = None) -> None:
        self._settings = settings or GraphSettings()
        self._recent: OrderedDict[bytes, list[_Proposal]] = OrderedDict()
        self._lock = Lock()

    @property
    def name(self) -> str:
        """Name, version, settings and version of the library that segments."""
        values = ",".join(f"{key}={value}" for key, value in self._settings.model_dump().items())
        return f"onboard-graph/1({values},scikit-image={version('scikit-image')})"

    @property
    def views_at_once(self) -> int:
        """One frame on each processor, up to four: a frame of a megapixel takes half a gigabyte."""
        return min(available_threads(), 4)

    def automatic(self, frame: Frame) -> list[Mask]:
        """All patches, coarse to fine and large to small; an empty list where nothing is shown."""
        masks = [proposal.mask for proposal in self._proposals(frame)]
        closed = [mask for mask in masks if mask.score >= self._settings.min_score]
        return closed if _covered(closed) >= 0.5 * _covered(masks) else masks

    def at_point(self, frame: Frame, point: tuple[float, float]) -> Mask:
        """The thing that a point lies in, else the surface that it lies on.

        A thing is a mask off the support planes behind most of whose outline (where nothing
        nearer covers it) the scene falls back or the support begins. The largest such mask that
        holds the point and is not most of the picture is taken; then, for a point that just
        misses, one within ``point_slack``. Else the mask that holds the point and is best closed
        by geometry: the ground or the wall.

        Args:
            frame: The picture.
            point: (x, y) in pixels.

        Returns:
            The mask; empty, with score 0, where the point is outside of the picture or nothing
            is near it.
        """
        height, width = frame.depth.shape
        empty = Mask(np.zeros((height, width), np.bool_), 0.0)
        if not (0 <= point[0] < width and 0 <= point[1] < height):
            return empty
        proposals = self._proposals(frame)
        row, column = int(point[1]), int(point[0])
        holding = [p for p in proposals if p.mask.pixels[row, column]]
        near = _disc(height, width, point, self._settings.point_slack)
        touching = [p for p in proposals if p.mask.pixels[near].any()]
        limit = self._settings.object_share * height * width
        for candidates in (holding, touching):
            things = [p.mask for p in candidates if p.is_thing and p.mask.area <= limit]
            if things:
                return max(things, key=lambda mask: mask.area)
        if not holding:
            return empty
        best = max(
            holding, key=lambda p: (round(p.mask.score, 1), p.mask.area <= limit, p.mask.area)
        )
        return best.mask

    def in_box(self, frame: Frame, box: tuple[float, float, float, float]) -> Mask:
        """The mask whose own box overlaps the given one best.

        Of masks that do so nearly as well (a thing and, say, the patch of ground around it) a
        thing goes first, then the largest.

        Args:
            frame: The picture.
            box: (x0, y0, x1, y1) in pixels.

        Returns:
            The mask; empty, with score 0, where none overlaps the box.
        """
        proposals = self._proposals(frame)
        overlaps = [_box_iou(p.mask.box, box) for p in proposals]
        top = max(overlaps, default=0.0)
        if top <= 0:
            return Mask(np.zeros(frame.depth.shape, np.bool_), 0.0)
        close = [p for p, o in zip(proposals, overlaps, strict=True) if o >= top - _BOX_MARGIN]
        return max(close, key=lambda p: (p.is_thing, p.mask.area)).mask

    def _proposals(self, frame: Frame) -> list[_Proposal]:
        """The frame's masks, made once and remembered for the prompts that follow."""
        key = content_key(frame)
        with self._lock:
            if key in self._recent:
                self._recent.move_to_end(key)
                return self._recent[key]
        proposals = self._segment(frame)
        with self._lock:
            self._recent[key] = proposals
            while len(self._recent) > _REMEMBERED:
                self._recent.popitem(last=False)
        return proposals

    def _segment(self, frame: Frame) -> list[_Proposal]:
        geometry = frame_geometry(frame)
        if not geometry.shown.any():
            return []
        minimum = max(4, round(self._settings.min_share * geometry.shown.size))
        levels = self._levels(frame, geometry, minimum)
        kept: list[tuple[int, Region]] = []
        for level in reversed(range(len(levels))):
            for region in regions_of(levels[level], geometry.shown, minimum):
                if len(kept) == self._settings.max_masks:
                    break
                if not any(_alike(region, other, self._settings.same_iou) for _, other in kept):
                    kept.append((level, region))
        proposals = []
        for level, region in kept:
            outline = outline_of(region, geometry)
            score = outline.closed if geometry.has_depth else 1.0
            mask = Mask(region.whole(geometry.shown.shape), score, level)
            proposals.append(_Proposal(mask, outline))
        return proposals

    def _levels(self, frame: Frame, geometry: FrameGeometry, minimum: int) -> list[LabelArray]:
        """Label pictures (H, W), finest first."""
        coarse = []
        if geometry.has_depth:
            features = _geometry_features(geometry)
            coarse = [
                _graph_based(features, scale, 0.0, minimum)
                for scale in self._settings.geometry_scales
            ]
        lab = rgb2lab(np.clip(frame.rgb, 0, 1)) / 100
        finest = coarse[0] if coarse else None
        if coarse:
            # Seen from above, steps in depth are heights of one thing, not gaps between two.
            limit = math.inf if geometry.from_above else self._settings.gap_limit
            focal = float(frame.camera.K[0, 0])
            coarse.append(merge_things(coarse[-1], geometry, focal, limit))
        fine = [_graph_based(lab, scale, 0.8, minimum) for scale in self._settings.colour_scales]
        if finest is not None:
            fine = [labels * (int(finest.max()) + 1) + finest for labels in fine]
        return fine + coarse


def _graph_based(
    features: NDArray[np.float64], scale: float, sigma: float, minimum: int
) -> LabelArray:
    """scikit-image's segmentation of features (H, W, 3); it does not hold the interpreter lock."""
    labels = felzenszwalb(features, scale=scale, sigma=sigma, min_size=minimum, channel_axis=-1)
    return np.asarray(labels, np.int64)


def _geometry_features(geometry: FrameGeometry) -> NDArray[np.float64]:
    """Features (H, W, 3): disparity, and a code of the support plane.

    Codes are about 1 apart, as much as the whole scene's depth, so that a thing never joins the
    ground that it touches without a step.
    """
    codes = np.array([[0.0, 0.0], [1.0, 0.0], [-0.5, 0.9], [-0.5, -0.9]])
    features = np.empty((*geometry.shown.shape, 3))
    # A plane is one surface however its depth runs, so it has no disparity of its own.
    standing = np.where(geometry.plane > 0, 0.0, np.minimum(geometry.disparity, 4.0))
    features[..., 0] = np.where(geometry.shown, standing, -2.0)
    features[..., 1:] = codes[geometry.plane]
    return features


def _covered(masks: Sequence[Mask]) -> int:
    """Number of pixels in any of the masks."""
    if not masks:
        return 0
    return int(np.count_nonzero(np.logical_or.reduce([mask.pixels for mask in masks])))


def _alike(a: Region, b: Region, limit: float) -> bool:
    """Whether two regions overlap by more than a limit; most pairs are told apart by area."""
    if min(a.area, b.area) <= limit * max(a.area, b.area):
        return False
    return a.iou(b) > limit


def _disc(height: int, width: int, point: tuple[float, float], slack: float) -> BoolArray:
    """(H, W) True within a fraction of the shorter side from a point."""
    x, y = np.arange(width) + 0.5 - point[0], np.arange(height) + 0.5 - point[1]
    near: BoolArray = x[None, :] ** 2 + y[:, None] ** 2 <= (slack * min(height, width)) ** 2
    return near


def _box_iou(a: tuple[int, int, int, int], b: tuple[float, float, float, float]) -> float:
    """Intersection over union of two boxes (x0, y0, x1, y1)."""
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    if width <= 0 or height <= 0:
        return 0.0
    union = (a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - width * height
    return float(width * height / union)
