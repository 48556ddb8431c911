"""(C) Online segmentation: bird's-eye view, frustum filtering, and the surrounding views (SMFI)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gvr_core.cameras import Camera, any_perpendicular, birds_eye_camera, ring_cameras, unit
from gvr_core.centres import centres_under
from gvr_core.gaussians import Gaussians
from gvr_core.models.base import Frame, Mask, Segmenter, TextSegmenter
from gvr_core.paper import (
    BEV_DISTANCE_FACTOR,
    RING_DISTANCE_FACTOR,
    RING_PITCH_DEGREES,
    RING_VIEWS_K,
    WIDTH_PERCENTILE,
)
from gvr_core.rendering.base import Renderer
from gvr_core.scene import Scene
from gvr_core.stopwatch import step

BoolArray = NDArray[np.bool_]
Float64Array = NDArray[np.float64]
Colour = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class VirtualView:
    """A virtual camera's picture of the scene, and the mask that a model cut from it."""

    frame: Frame
    mask: Mask | None
    """None where the model found nothing."""


def frustum_filter(
    gaussians: Gaussians, camera: Camera, mask: BoolArray, asked: BoolArray | None = None
) -> BoolArray:
    """Frustum filtering: the Gaussians whose centre projects into the mask.

    Args:
        gaussians: The scene G.
        camera: The camera that the mask belongs to.
        mask: (H, W).
        asked: (N,) flags of the Gaussians to look at; the others are not flagged. None for all.

    Returns:
        (N,) flags. A centre behind the camera or outside the picture is never flagged.
    """
    return centres_under(gaussians.means, camera, mask, asked)


def focus_point(cameras: Sequence[Camera]) -> Float64Array:
    """The point nearest to all optical axes: what the cameras look at together.

    The paper does not say where the bird's-eye camera stands without retrieval; above this
    point is our reading.

    Args:
        cameras: The knowledge cameras.

    Returns:
        (3,), world frame; for parallel axes the point nearest to them that is also nearest to
        the mean camera centre.
    """
    eyes = np.stack([camera.position for camera in cameras])
    axes = np.stack([camera.forward for camera in cameras])
    across = np.eye(3)[None] - axes[:, :, None] * axes[:, None, :]
    centre = eyes.mean(axis=0)
    offsets = np.einsum("nij,nj->i", across, eyes - centre)
    point: Float64Array = centre + np.linalg.pinv(across.sum(axis=0), rcond=1e-6) @ offsets
    return point


def birds_eye_view(
    scene: Scene,
    location: Float64Array,
    renderer: Renderer,
    distance_factor: float = BEV_DISTANCE_FACTOR,
    background: Colour = (0.0, 0.0, 0.0),
) -> Frame:
    """Render the scene from straight above a location, c_BEV.

    Args:
        scene: The scene, whole.
        location: (3,) L_3D; falls on the picture's principal point.
        renderer: Draws it.
        distance_factor: Height above the location, in mean distances of the knowledge cameras.
        background: Colour behind everything.
    """
    model = scene.views[0].camera
    eyes = np.stack([view.camera.position for view in scene.views])
    height = distance_factor * float(np.linalg.norm(eyes - location, axis=1).mean())
    camera = birds_eye_camera(
        location, scene.up_direction, height, model.K, model.width, model.height
    )
    with step("BEV render"):
        return Frame.of_rendering(renderer.render(scene.gaussians, camera, background), camera)


def coarse_by_point(
    scene: Scene, bev: Frame, location: Float64Array, segmenter: Segmenter
) -> tuple[BoolArray, VirtualView]:
    """The coarse set: point prompt at the projected location, then frustum filtering.

    Args:
        scene: The scene.
        bev: The bird's-eye view.
        location: (3,) L_3D.
        segmenter: SAM's role.

    Returns:
        (N,) flags, and the bird's-eye view with its mask.
    """
    (x, y), _ = bev.camera.project(location)
    with step("models"):
        mask = segmenter.at_point(bev, (float(x), float(y)))
    with step("BEV filter"):
        coarse = frustum_filter(scene.gaussians, bev.camera, mask.pixels)
    return coarse, VirtualView(bev, mask)


def coarse_by_text(
    scene: Scene, bev: Frame, text: str, text_segmenter: TextSegmenter
) -> tuple[BoolArray, VirtualView]:
    """The coarse set without RFL: the text mask on the bird's-eye view, then frustum filtering.

    Args:
        scene: The scene.
        bev: The bird's-eye view.
        text: The query.
        text_segmenter: Grounding DINO's and SAM's role.

    Returns:
        (N,) flags, all False where the text names nothing in the view, and the view.
    """
    with step("models"):
        mask = text_segmenter.segment(bev, text)
    if mask is None:
        return np.zeros(len(scene.gaussians), dtype=np.bool_), VirtualView(bev, None)
    with step("BEV filter"):
        coarse = frustum_filter(scene.gaussians, bev.camera, mask.pixels)
    return coarse, VirtualView(bev, mask)


def target_width(means: NDArray[np.float32], up: Float64Array) -> float:
    """w_tar: the width of the coarse set across the up direction.

    Args:
        means: (n, 3) centres of the coarse Gaussians, n >= 1.
        up: (3,) unit vector.

    Returns:
        Twice the 90th percentile of their horizontal distances from their median, scene units.
    """
    first = any_perpendicular(unit(up))
    plane = np.stack([first, np.cross(up, first)])
    flat = means.astype(np.float64) @ plane.T
    distances = np.linalg.norm(flat - np.median(flat, axis=0), axis=1)
    return 2.0 * float(np.percentile(distances, WIDTH_PERCENTILE))


def surrounding_views(
    scene: Scene,
    coarse: BoolArray,
    location: Float64Array,
    text: str,
    renderer: Renderer,
    text_segmenter: TextSegmenter,
    k: int = RING_VIEWS_K,
    distance_factor: float = RING_DISTANCE_FACTOR,
    pitch_degrees: float = RING_PITCH_DEGREES,
    background: Colour = (0.0, 0.0, 0.0),
) -> list[VirtualView]:
    """The k ring cameras' renders of the coarse set, each with its text mask.

    Args:
        scene: The scene.
        coarse: (N,) flags, at least one set.
        location: (3,) L_3D, the centre of the ring.
        text: The query.
        renderer: Draws the coarse set.
        text_segmenter: Grounding DINO's and SAM's role.
        k: Number of cameras.
        distance_factor: d_vir in widths of the coarse set.
        pitch_degrees: Pitch above the horizontal.
        background: Colour behind the coarse set.
    """
    up, model = scene.up_direction, scene.views[0].camera
    # A single Gaussian has no width of its own; its standard deviation stands in.
    width = max(
        target_width(scene.gaussians.means[coarse], up),
        float(scene.gaussians.scales[coarse].max(axis=1).mean()),
    )
    cameras = ring_cameras(
        location, up, distance_factor * width, pitch_degrees, k, model.K, model.width, model.height
    )
    with step("ring renders"):
        drawn = list(renderer.render_many(scene.gaussians, cameras, background, coarse))
        frames = [
            Frame.of_rendering(rendering, camera, coarse)
            for rendering, camera in zip(drawn, cameras, strict=True)
        ]
    with step("models"):
        return [VirtualView(frame, text_segmenter.segment(frame, text)) for frame in frames]


def intersect(gaussians: Gaussians, coarse: BoolArray, views: Sequence[VirtualView]) -> BoolArray:
    """SMFI: the coarse Gaussians that frustum filtering keeps in every surrounding view.

    A view in which the text names nothing keeps none, so the intersection is then empty: that
    is what an intersection says, and what the paper's text says.

    Args:
        gaussians: The scene G.
        coarse: (N,) flags.
        views: The surrounding views.

    Returns:
        I_tar: (N,) flags.
    """
    flags = coarse
    for view in views:
        if view.mask is None:
            return np.zeros_like(coarse)
        with step("ring filters"):
            flags = frustum_filter(gaussians, view.frame.camera, view.mask.pixels, flags)
    return flags.copy() if flags is coarse else flags
