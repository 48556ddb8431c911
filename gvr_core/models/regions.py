"""Regions of label pictures, kept as small cut-outs: dozens a frame would else cost seconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gvr_core.models.base import BoolArray

LabelArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Region:
    """A connected region of a picture."""

    pixels: BoolArray
    """(h, w) True inside; just as large as the region's box."""
    top: int
    """First row of the box in the picture."""
    left: int
    """First column of the box in the picture."""
    area: int
    """Number of pixels inside."""

    def whole(self, shape: tuple[int, ...]) -> BoolArray:
        """The region in a picture of a shape (H, W)."""
        picture = np.zeros(shape, np.bool_)
        height, width = self.pixels.shape
        picture[self.top : self.top + height, self.left : self.left + width] = self.pixels
        return picture

    def overlap(self, other: Region) -> int:
        """Number of pixels in both regions."""
        top, left = max(self.top, other.top), max(self.left, other.left)
        bottom = min(self.top + self.pixels.shape[0], other.top + other.pixels.shape[0])
        right = min(self.left + self.pixels.shape[1], other.left + other.pixels.shape[1])
        if bottom <= top or right <= left:
            return 0
        mine = self.pixels[top - self.top : bottom - self.top, left - self.left : right - self.left]
        theirs = other.pixels[
            top - other.top : bottom - other.top, left - other.left : right - other.left
        ]
        return int(np.count_nonzero(mine & theirs))

    def iou(self, other: Region) -> float:
        """Intersection over union of two regions."""
        common = self.overlap(other)
        return common / (self.area + other.area - common)


def regions_of(labels: LabelArray, shown: BoolArray, minimum: int) -> list[Region]:
    """Connected regions of a label picture.

    Args:
        labels: (H, W) numbers; equal neighbours (by an edge) belong together.
        shown: (H, W) False where nothing is; no region reaches there.
        minimum: Regions of fewer pixels are dropped, and holes of fewer pixels are filled. (A
            larger hole may be another thing, as one that stands on the ground is for it.)

    Returns:
        Regions from large to small; of equal ones the one whose box begins first.
    """
    dense = dense_labels(np.where(shown, labels, -1))
    regions = []
    for value, box in enumerate(ndimage.find_objects(dense + 1)):
        inside = dense[box] == value
        if np.count_nonzero(inside) < minimum or not shown[box][inside].all():
            continue
        parts, count = ndimage.label(inside)
        sizes = np.bincount(parts.ravel(), minlength=count + 1)
        for part, inner in enumerate(ndimage.find_objects(parts), start=1):
            if sizes[part] < minimum:
                continue
            top, left = box[0].start + inner[0].start, box[1].start + inner[1].start
            pixels = _without_holes(parts[inner] == part, minimum)
            height, width = pixels.shape
            pixels &= shown[top : top + height, left : left + width]
            regions.append(Region(pixels, top, left, int(np.count_nonzero(pixels))))
    return sorted(regions, key=lambda r: (-r.area, r.top, r.left))


def dense_labels(labels: LabelArray) -> LabelArray:
    """Label pictures (H, W) with the numbers 0, 1, ... in the order of the old ones.

    Counts instead of sorting where the numbers are not much larger than the picture: sorting a
    megapixel takes ten times as long.
    """
    low, high = int(labels.min()), int(labels.max())
    if high - low > 4 * labels.size:
        return np.unique(labels, return_inverse=True)[1].reshape(labels.shape)
    there = np.zeros(high - low + 1, np.bool_)
    there[labels - low] = True
    numbers = np.cumsum(there) - 1
    return np.asarray(numbers[labels - low], np.int64)


def _without_holes(pixels: BoolArray, limit: int) -> BoolArray:
    """A region with its holes of fewer pixels than the limit filled."""
    holes, count = ndimage.label(ndimage.binary_fill_holes(pixels) & ~pixels)
    if count == 0:
        return pixels
    small = np.bincount(holes.ravel(), minlength=count + 1) < limit
    small[0] = False
    filled: BoolArray = pixels | small[holes]
    return filled
