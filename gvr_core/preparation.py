"""(A) Preparation: render the views and their depth, cut them into patches, encode the patches.

Each function is one stage, and depends on nothing but its arguments.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from gvr_core.books import DepthBook, PatchBook, SemanticVectorBook, ViewBook, view_frame
from gvr_core.gaussians import Gaussians
from gvr_core.models.base import Encoder, Segmenter
from gvr_core.rendering.base import Renderer
from gvr_core.scene import View

T = TypeVar("T")
Progress = Callable[[Iterable[T]], Iterable[T]]
"""Wraps the loop over views, e.g. in a progress bar."""


def _silent(items: Iterable[T]) -> Iterable[T]:
    return items


def render_views(
    gaussians: Gaussians,
    views: Sequence[View],
    renderer: Renderer,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    progress: Progress[View] = _silent,
) -> ViewBook:
    """Render every knowledge view.

    Args:
        gaussians: The scene G.
        views: The n views.
        renderer: Draws them.
        background: Colour behind everything.
        progress: Wraps the loop over views.
    """
    colours, alphas, sizes = [], [], []
    for view in progress(views):
        rendering = renderer.render(gaussians, view.camera, background)
        colours.append(_to_bytes(rendering.rgb).reshape(-1, 3))
        alphas.append(_to_bytes(rendering.alpha).ravel())
        sizes.append((view.camera.height, view.camera.width))
    return ViewBook(
        np.concatenate(colours), np.concatenate(alphas), np.array(sizes, dtype=np.int32)
    )


def render_depths(
    gaussians: Gaussians,
    views: Sequence[View],
    renderer: Renderer,
    progress: Progress[View] = _silent,
) -> DepthBook:
    """Render the depth of every knowledge view: the Depth Book.

    Args:
        gaussians: The scene G.
        views: The n views.
        renderer: Draws them.
        progress: Wraps the loop over views.
    """
    expected, median, sizes = [], [], []
    for view in progress(views):
        rendering = renderer.render(gaussians, view.camera)
        expected.append(rendering.expected_depth.ravel())
        median.append(rendering.median_depth.ravel())
        sizes.append((view.camera.height, view.camera.width))
    return DepthBook(
        np.concatenate(expected), np.concatenate(median), np.array(sizes, dtype=np.int32)
    )


def segment_views(
    views: ViewBook,
    depths: DepthBook,
    cameras: Sequence[View],
    segmenter: Segmenter,
    progress: Progress[int] = _silent,
) -> PatchBook:
    """Cut every view into patches.

    Args:
        views: The rendered views.
        depths: Their depths.
        cameras: The same views' cameras.
        segmenter: SAM's role.
        progress: Wraps the loop over views.
    """
    masks = [
        segmenter.automatic(view_frame(views, depths, i, cameras[i]))
        for i in progress(range(len(views)))
    ]
    return PatchBook.of_masks(masks, [(int(h), int(w)) for h, w in views.sizes])


def encode_patches(
    views: ViewBook,
    depths: DepthBook,
    cameras: Sequence[View],
    patches: PatchBook,
    encoder: Encoder,
    progress: Progress[int] = _silent,
) -> SemanticVectorBook:
    """Encode every patch of every view: the Semantic Vector Book.

    Args:
        views: The rendered views.
        depths: Their depths.
        cameras: The same views' cameras.
        patches: The patches.
        encoder: CLIP's image side.
        progress: Wraps the loop over views.
    """
    features = [np.empty((0, encoder.dim), np.float32)]
    for i in progress(range(len(views))):
        masks = patches.masks_of(i)
        if masks:
            frame = view_frame(views, depths, i, cameras[i])
            features.append(encoder.encode_patches(frame, masks))
    return SemanticVectorBook(np.concatenate(features), patches)


def _to_bytes(unit_values: NDArray[np.float32]) -> NDArray[np.uint8]:
    rounded: NDArray[np.float32] = np.rint(np.clip(unit_values, 0, 1) * np.float32(255))
    return rounded.astype(np.uint8)
