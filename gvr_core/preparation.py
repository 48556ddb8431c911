"""(A) Preparation: render the views and their depth, cut them into patches, encode the patches.

Each function is one stage, and depends on nothing but its arguments.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from gvr_core.books import DepthBook, PatchBook, SemanticVectorBook, ViewBook, view_frame
from gvr_core.gaussians import Gaussians
from gvr_core.models.base import Encoder, Mask, Segmenter, views_at_once
from gvr_core.ordered import in_order
from gvr_core.rendering.base import Renderer
from gvr_core.scene import View

T = TypeVar("T")
Progress = Callable[[Iterable[T]], Iterable[T]]
"""Wraps the loop over views, e.g. in a progress bar."""


def _silent(items: Iterable[T]) -> Iterable[T]:
    return items


@dataclass(frozen=True, eq=False)
class RenderedView:
    """One view's part of the View Book and of the Depth Book, from one render."""

    values: NDArray[np.uint8]
    """(H W, 3) colours, row by row."""
    alphas: NDArray[np.uint8]
    """(H W,) opacities."""
    expected: NDArray[np.float32]
    """(H W,) expected depth."""
    median: NDArray[np.float32]
    """(H W,) median depth."""


def view_sizes(views: Sequence[View]) -> NDArray[np.int32]:
    """Height and width (n, 2) of every view, pixels."""
    sizes = [(view.camera.height, view.camera.width) for view in views]
    return np.array(sizes, dtype=np.int32).reshape(-1, 2)


def render_each(
    gaussians: Gaussians,
    views: Sequence[View],
    renderer: Renderer,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    progress: Progress[View] = _silent,
) -> Iterator[RenderedView]:
    """Render every knowledge view once: colour, opacity and both depths.

    Args:
        gaussians: The scene G.
        views: The n views.
        renderer: Draws them.
        background: Colour behind everything.
        progress: Wraps the loop over views.

    Yields:
        View after view; whoever keeps no more than one needs memory for one.
    """
    for view in progress(views):
        rendering = renderer.render(gaussians, view.camera, background)
        yield RenderedView(
            _to_bytes(rendering.rgb).reshape(-1, 3),
            _to_bytes(rendering.alpha).ravel(),
            rendering.expected_depth.ravel(),
            rendering.median_depth.ravel(),
        )


def render_books(
    gaussians: Gaussians,
    views: Sequence[View],
    renderer: Renderer,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[ViewBook, DepthBook]:
    """The View Book and the Depth Book in memory: 12 bytes a pixel of every view.

    Args:
        gaussians: The scene G.
        views: The n views.
        renderer: Draws them.
        background: Colour behind everything.
    """
    sizes = view_sizes(views)
    n = int(sizes.prod(axis=1, dtype=np.int64).sum())
    book = ViewBook(np.empty((n, 3), np.uint8), np.empty(n, np.uint8), sizes)
    depths = DepthBook(np.empty(n, np.float32), np.empty(n, np.float32), sizes)
    start = 0
    for view in render_each(gaussians, views, renderer, background):
        part = slice(start, start + len(view.alphas))
        book.values[part], book.alphas[part] = view.values, view.alphas
        depths.expected[part], depths.median[part] = view.expected, view.median
        start = part.stop
    return book, depths


def segment_views(
    views: ViewBook,
    depths: DepthBook,
    cameras: Sequence[View],
    segmenter: Segmenter,
    progress: Progress[int] = _silent,
) -> PatchBook:
    """Cut every view into patches, some views at a time where the segmenter allows it.

    Args:
        views: The rendered views.
        depths: Their depths.
        cameras: The same views' cameras.
        segmenter: SAM's role.
        progress: Wraps the loop over views.
    """

    def cut(i: int) -> list[Mask]:
        return segmenter.automatic(view_frame(views, depths, i, cameras[i]))

    masks = in_order(cut, progress(range(len(views))), views_at_once(segmenter))
    return PatchBook.of_masks(masks, [(int(h), int(w)) for h, w in views.sizes])


def encode_patches(
    views: ViewBook,
    depths: DepthBook,
    cameras: Sequence[View],
    patches: PatchBook,
    encoder: Encoder,
    progress: Progress[int] = _silent,
) -> SemanticVectorBook:
    """Encode every patch of every view: the Semantic Vector Book, in half precision.

    Args:
        views: The rendered views.
        depths: Their depths.
        cameras: The same views' cameras.
        patches: The patches.
        encoder: CLIP's image side.
        progress: Wraps the loop over views.
    """

    def encode(i: int) -> NDArray[np.float16]:
        masks = patches.masks_of(i)
        if not masks:
            return np.empty((0, encoder.dim), np.float16)
        frame = view_frame(views, depths, i, cameras[i])
        return encoder.encode_patches(frame, masks).astype(np.float16)

    features = [np.empty((0, encoder.dim), np.float16)]
    features += in_order(encode, progress(range(len(views))), views_at_once(encoder))
    return SemanticVectorBook(np.concatenate(features), patches)


def _to_bytes(unit_values: NDArray[np.float32]) -> NDArray[np.uint8]:
    rounded: NDArray[np.float32] = np.rint(np.clip(unit_values, 0, 1) * np.float32(255))
    return rounded.astype(np.uint8)
