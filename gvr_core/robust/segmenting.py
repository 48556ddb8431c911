"""(C) of ``gvr-robust``: from one place to the Gaussians of the object there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gvr_core.books import Books
from gvr_core.cameras import Camera, birds_eye_camera, ring_cameras
from gvr_core.localize import Localization, Place
from gvr_core.methods.base import Toolbox
from gvr_core.methods.robust_config import RobustSegment
from gvr_core.metrics import iou
from gvr_core.models.base import Frame
from gvr_core.robust.ballot import Ballot, centre_weights, mask_weights
from gvr_core.robust.cleanup import follow_neighbours
from gvr_core.robust.observation import observed_share
from gvr_core.scene import Scene
from gvr_core.segment import VirtualView, target_width

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float32]
Float64Array = NDArray[np.float64]
Weights = tuple[FloatArray, FloatArray]

LEAST_TRUST = 0.05
"""A detection counts at least so much, whatever its score."""
LEAST_VOTING_VIEWS = 2
"""With fewer voting views the coarse set is the answer."""
EXTENT_PERCENTILES = (2.0, 98.0)
"""The coarse set's extent for the ring: a few strays do not push the cameras away."""


@dataclass(frozen=True, eq=False)
class Workplace:
    """What segmenting works with."""

    scene: Scene
    """With the up direction to use."""
    books: Books
    tools: Toolbox
    config: RobustSegment
    steady: BoolArray
    """(N,) the Gaussians to draw in virtual views."""
    background: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Segmented:
    """The object at one place, and the evidence."""

    flags: BoolArray
    """(N,)."""
    scores: FloatArray
    """(N,) in [0, 1]: share of the votes."""
    bev: VirtualView | None = None
    ring: Sequence[VirtualView] = ()


def segment_area(work: Workplace, localization: Localization) -> Segmented:
    """An area (lawn, wall): no view from above or around shows it whole, so views are lifted."""
    ballot = Ballot(len(work.scene.gaussians))
    _ask_views(work, localization, 0, ballot)
    return _count(work, ballot, ballot.share >= work.config.keep_at)


def segment_thing(work: Workplace, localization: Localization, index: int, text: str) -> Segmented:
    """A thing at a place: bird's-eye view, retrieved views and ring, each with its vote.

    Args:
        work: What to work with.
        localization: All places, and the patches behind them.
        index: Which place.
        text: The query, for the ring.
    """
    config, place = work.config, localization.places[index]
    ballot = Ballot(len(work.scene.gaussians))
    bev, coarse = _birds_eye(work, place)
    if coarse is None or config.retrieved_views:
        lifted = Ballot(len(work.scene.gaussians))
        _ask_views(work, localization, index, lifted)
        seeds = lifted.share >= config.keep_at
        coarse = seeds if coarse is None else coarse | seeds
        if config.retrieved_views:
            ballot = lifted
    if not coarse.any():
        return Segmented(coarse, coarse.astype(np.float32), bev)
    ring = _look_around(work, coarse, place, text)
    if not config.soft_vote:
        return _intersection(work, coarse, bev, ring, ballot)
    for view in ring:
        if view.mask is not None:
            _add_virtual(work, ballot, view, coarse, place.location)
    if bev.mask is not None:
        _add_virtual(work, ballot, bev, bev.frame.shown, place.location)
    if ballot.views < LEAST_VOTING_VIEWS:
        return Segmented(coarse, coarse.astype(np.float32), bev, ring)
    return _count(work, ballot, coarse, bev, ring)


def _birds_eye(work: Workplace, place: Place) -> tuple[VirtualView, BoolArray | None]:
    """The view from above, and the coarse set; None where the view is not to be trusted."""
    scene, config = work.scene, work.config
    up, model = scene.up_direction, scene.views[0].camera
    drawn = work.steady
    if config.bev_clip:
        heights = (scene.gaussians.means - place.location) @ up
        drawn = drawn & (heights <= (1 + config.clip_margin) * place.radius)
    eyes = np.stack([view.camera.position for view in scene.views])
    away = config.bev_distance * float(np.linalg.norm(eyes - place.location, axis=1).mean())
    camera = birds_eye_camera(place.location, up, away, model.K, model.width, model.height)
    if not drawn.any():
        drawn = work.steady
    frame = _draw(work, camera, drawn)
    (x, y), _ = camera.project(place.location)
    mask = work.tools.models.segmenter.at_point(frame, (float(x), float(y)))
    if config.bev_gate:
        share = observed_share(
            scene, work.books.depths, frame, mask.pixels, config.observed_degrees
        )
        if share < config.observed_share:
            return VirtualView(frame, None), None
    inside, outside = centre_weights(scene.gaussians, camera, mask.pixels, drawn)
    column = inside > 0
    if config.weight_filter:
        # what the view sees is judged by its weights; what lies under it, by the column
        inside, outside = mask_weights(
            work.tools.renderer, scene.gaussians, camera, mask.pixels, drawn
        )
        seen = inside + outside > 0.5
        column = np.where(seen, inside > outside, column)
    return VirtualView(frame, mask), column


def _ask_views(work: Workplace, localization: Localization, index: int, ballot: Ballot) -> None:
    """The retrieved views vote with their own patches."""
    scene, patches = work.scene, work.books.semantics.patches
    supporters = localization.labels == index
    masks: dict[int, BoolArray] = {}
    trust: dict[int, float] = {}
    retrieval = localization.retrieval
    for view, patch, relevancy in zip(
        retrieval.views[supporters],
        retrieval.patches[supporters],
        retrieval.relevancies[supporters],
        strict=True,
    ):
        i, pixels = int(view), patches.pixels(int(patch))
        masks[i] = masks[i] | pixels if i in masks else pixels
        trust[i] = max(trust.get(i, LEAST_TRUST), float(relevancy))
    location = localization.places[index].location
    chosen = spread_views(
        np.stack([scene.views[i].camera.position for i in masks]),
        location,
        np.array([trust[i] for i in masks]),
        work.config.vote_views,
    )
    names = list(masks)
    for i in (names[j] for j in chosen):
        camera = scene.views[i].camera
        weights = _weights(work, camera, masks[i], None)
        ballot.add(weights, trust[i] * _pixel_area(work, camera, location))


def spread_views(
    eyes: Float64Array, location: Float64Array, trust: Float64Array, most: int
) -> list[int]:
    """Views that look from as many directions as possible, the most trusted one first.

    Args:
        eyes: (v, 3) camera centres.
        location: (3,) what they look at.
        trust: (v,) how much each counts.
        most: How many to take.

    Returns:
        Indices, in ascending order.
    """
    if len(eyes) <= most:
        return list(range(len(eyes)))
    directions = eyes - location
    directions = directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
    chosen = [int(np.argmax(trust))]
    nearest = directions @ directions[chosen[0]]
    while len(chosen) < most:
        nearest[chosen] = np.inf
        chosen.append(int(np.argmin(nearest)))
        nearest = np.maximum(nearest, directions @ directions[chosen[-1]])
    return sorted(chosen)


def _look_around(work: Workplace, coarse: BoolArray, place: Place, text: str) -> list[VirtualView]:
    """The ring's pictures of the coarse set, each with what the text names in it, if anything."""
    scene, config = work.scene, work.config
    up, model = scene.up_direction, scene.views[0].camera
    drawn = coarse & work.steady
    if not drawn.any():
        drawn = coarse
    target = scene.gaussians.subset(drawn)
    width = max(target_width(target.means, up), float(target.scales.max(axis=1).mean()))
    centre, distance = place.location, config.ring_distance * width
    if config.ring_fit:
        low, high = np.percentile(target.means, EXTENT_PERCENTILES, axis=0)
        centre = (low + high) / 2
        reach = np.linalg.norm(target.means - centre, axis=1)
        half = np.arctan(min(model.width / model.K[0, 0], model.height / model.K[1, 1]) / 2)
        fits = float(np.percentile(reach, EXTENT_PERCENTILES[1]) / np.sin(half))
        distance = max(distance, fits)
    cameras = ring_cameras(
        centre,
        up,
        distance,
        config.ring_pitch,
        config.ring_views,
        model.K,
        model.width,
        model.height,
    )
    views = []
    for camera in cameras:
        frame = _draw(work, camera, drawn)
        mask = work.tools.models.text_segmenter.segment(frame, text)
        if mask is not None and config.soft_vote and frame.alpha is not None:
            silhouette = frame.alpha > 0.5
            mask = mask if iou(mask.pixels, silhouette) >= config.agree_iou else None
        views.append(VirtualView(frame, mask))
    return views


def _add_virtual(
    work: Workplace,
    ballot: Ballot,
    view: VirtualView,
    drawn: BoolArray | None,
    location: Float64Array,
) -> None:
    if view.mask is None:
        return
    camera = view.frame.camera
    weights = _weights(work, camera, view.mask.pixels, drawn)
    ballot.add(weights, max(LEAST_TRUST, view.mask.score) * _pixel_area(work, camera, location))


def _count(
    work: Workplace,
    ballot: Ballot,
    coarse: BoolArray,
    bev: VirtualView | None = None,
    ring: Sequence[VirtualView] = (),
) -> Segmented:
    """The answer of the votes: what is seen by its share, the rest by its neighbours."""
    share, seen = ballot.share, ballot.seen
    flags = np.where(seen, share >= work.config.keep_at, coarse)
    if work.config.cleanup:
        flags = follow_neighbours(work.scene.gaussians.means, flags, seen, work.config.neighbours)
    scores = np.where(flags, np.maximum(share, 0.5), np.minimum(share, 0.49))
    return Segmented(flags, scores.astype(np.float32), bev, ring)


def _intersection(
    work: Workplace,
    coarse: BoolArray,
    bev: VirtualView | None,
    ring: Sequence[VirtualView],
    ballot: Ballot,
) -> Segmented:
    """The paper's rule: what every ring view keeps, and nothing where one has no detection."""
    flags = coarse.copy()
    for view in ring:
        if view.mask is None:
            flags[:] = False
            break
        inside, outside = _weights(work, view.frame.camera, view.mask.pixels, coarse)
        flags &= inside >= outside
    return Segmented(flags, flags.astype(np.float32), bev, ring)


def _weights(work: Workplace, camera: Camera, mask: BoolArray, drawn: BoolArray | None) -> Weights:
    gaussians = work.scene.gaussians
    if work.config.weight_filter:
        return mask_weights(work.tools.renderer, gaussians, camera, mask, drawn)
    return centre_weights(gaussians, camera, mask, drawn)


def _draw(work: Workplace, camera: Camera, drawn: BoolArray) -> Frame:
    shown = work.scene.gaussians.subset(drawn)
    rendering = work.tools.renderer.render(shown, camera, work.background)
    return Frame.of_rendering(rendering, camera, drawn)


def _pixel_area(work: Workplace, camera: Camera, location: Float64Array) -> float:
    """Area that a pixel covers at a place, in those of the knowledge views.

    A near view has more pixels on an object than a far one, and no more to say.
    """
    areas = [_area(view.camera, location) for view in work.scene.views]
    return _area(camera, location) / float(np.median(areas))


def _area(camera: Camera, location: Float64Array) -> float:
    return float((np.linalg.norm(camera.position - location) / camera.K[0, 0]) ** 2)
