"""The virtual views of ``gvr-robust``: from above, and from around."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gvr_core.cameras import birds_eye_camera, ring_cameras
from gvr_core.localize import Place
from gvr_core.metrics import iou
from gvr_core.robust.observation import observed_share
from gvr_core.robust.workplace import Weights, Workplace
from gvr_core.segment import VirtualView, target_width
from gvr_core.stopwatch import step

BoolArray = NDArray[np.bool_]

EXTENT_PERCENTILES = (2.0, 98.0)
"""The coarse set's extent for the ring: a few strays do not push the cameras away."""


@dataclass(frozen=True, eq=False)
class BirdsEye:
    """The view from above, and what it says."""

    view: VirtualView
    coarse: BoolArray | None
    """(N,) what its mask keeps; None where the view is not to be trusted."""
    weights: Weights | None = None
    """What counts inside and outside of its mask, each (N,); None likewise."""


def birds_eye(work: Workplace, place: Place) -> BirdsEye:
    """Look down on a place, under the ceiling, and say whether that can be trusted.

    Args:
        work: What to work with.
        place: Where the object is.
    """
    scene, config, lens = work.scene, work.config, work.lens
    drawn = work.steady
    if config.bev_clip:
        heights = (scene.gaussians.means - place.location) @ scene.up_direction
        clipped = drawn & (heights <= (1 + config.clip_margin) * place.radius)
        drawn = clipped if clipped.any() else drawn
    eyes = np.stack([view.camera.position for view in scene.views])
    away = config.bev_distance * float(np.linalg.norm(eyes - place.location, axis=1).mean())
    camera = birds_eye_camera(
        place.location, scene.up_direction, away, lens.K, lens.width, lens.height
    )
    with step("BEV render"):
        frame = work.draw([camera], drawn)[0]
    (x, y), _ = camera.project(place.location)
    with step("models"):
        mask = work.tools.models.segmenter.at_point(frame, (float(x), float(y)))
    view = VirtualView(frame, mask)
    if config.bev_gate:
        with step("BEV gate"):
            seen = observed_share(
                scene, work.books.depths, frame, mask.pixels, config.observed_degrees
            )
        if seen < config.observed_share:
            return BirdsEye(view, None)
    with step("BEV filter"):
        weights = work.weights(camera, mask.pixels, drawn)
        return BirdsEye(view, work.keeps(camera, mask.pixels, drawn, weights), weights)


def look_around(work: Workplace, coarse: BoolArray, place: Place, text: str) -> list[VirtualView]:
    """The ring's pictures of the coarse set, each with what the text names in it, if anything.

    Args:
        work: What to work with.
        coarse: (N,) flags, at least one set.
        place: Where the object is.
        text: The query.
    """
    config, lens, up = work.config, work.lens, work.scene.up_direction
    drawn = coarse & work.steady
    if not drawn.any():
        drawn = coarse
    means = work.scene.gaussians.means[drawn]
    sizes = work.scene.gaussians.scales[drawn].max(axis=1)
    width = max(target_width(means, up), float(sizes.mean()))
    centre, distance = place.location, config.ring_distance * width
    if config.ring_fit:
        low, high = np.percentile(means, EXTENT_PERCENTILES, axis=0)
        centre = (low + high) / 2
        reach = np.linalg.norm(means - centre, axis=1) + sizes
        fits = float(np.percentile(reach, EXTENT_PERCENTILES[1]) / np.sin(lens.half_angle))
        distance = max(distance, fits)
    cameras = ring_cameras(
        centre,
        up,
        distance,
        config.ring_pitch,
        config.ring_views,
        lens.K,
        lens.width,
        lens.height,
    )
    with step("ring renders"):
        frames = work.draw(cameras, drawn)
    views = []
    for frame in frames:
        with step("models"):
            mask = work.tools.models.text_segmenter.segment(frame, text)
        if mask is not None and config.soft_vote and frame.alpha is not None:
            agreement = iou(mask.pixels, frame.alpha > 0.5)
            mask = mask if agreement >= config.agree_iou else None
        views.append(VirtualView(frame, mask))
    return views
