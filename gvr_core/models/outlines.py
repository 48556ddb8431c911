"""What a region's outline runs along: a step in depth, the edge of a support, or nothing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from gvr_core.models.frame_geometry import FrameGeometry
from gvr_core.models.regions import Region

STEP = 0.03
"""Neighbouring pixels whose depths differ by more than this share lie on different surfaces."""


class Outline(NamedTuple):
    """Shares of a region's outline. Where the region meets the picture's edge has no say."""

    closed: float
    """On a geometric edge of any kind: a step in depth to either side, a support plane that
    begins or ends, or nothing behind. 1 for whole things and whole planes; low for a piece of a
    surface that only its colour sets apart."""
    stands: float
    """Of the outline that nothing nearer covers: where the scene falls back behind the region,
    or its support begins. 1 for things in front of others, near 0 for the ground."""
    on_plane: float
    """Share of the region's pixels (not of its outline) that lie on a support plane."""


def outline_of(region: Region, geometry: FrameGeometry) -> Outline:
    """What a region's outline runs along."""
    height, width = geometry.shown.shape
    h, w = region.pixels.shape
    # One pixel more on each side, as far as the picture goes, holds the outer rim.
    top, left = max(0, region.top - 1), max(0, region.left - 1)
    bottom, right = min(height, region.top + h + 1), min(width, region.left + w + 1)
    window = np.s_[top:bottom, left:right]
    inside = np.zeros((bottom - top, right - left), np.bool_)
    inside[region.top - top : region.top - top + h, region.left - left : region.left - left + w] = (
        region.pixels
    )
    plane = geometry.plane[window]
    on_plane = float(np.mean(plane[inside] > 0))
    rim = ndimage.binary_dilation(inside) & ~inside
    if not rim.any():
        return Outline(1.0, 0.0 if on_plane > 0.5 else 1.0, on_plane)
    disparity = geometry.disparity[window]
    # Each pixel of the rim is compared with the region's pixels that touch it by an edge.
    cross = ndimage.generate_binary_structure(2, 1)
    nearest = ndimage.maximum_filter(np.where(inside, disparity, 0), footprint=cross)[rim]
    outside = disparity[rim]
    own = int(np.bincount(plane[inside]).argmax())
    falls = (outside < (1 - STEP) * nearest) | ((plane[rim] > 0) & (plane[rim] != own))
    rises = outside * (1 - STEP) > nearest
    leaves = (own > 0) & (plane[rim] != own)
    open_share = float(np.mean(~(falls | rises | leaves)))
    uncovered = np.count_nonzero(falls | ~rises)
    stands = np.count_nonzero(falls) / uncovered if uncovered else 0.0
    return Outline(1.0 - open_share, float(stands) if own == 0 else 0.0, on_plane)
