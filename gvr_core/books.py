"""The knowledge books of a scene: what its views show, how deep, in which patches, and what of.

The paper writes the Semantic Vector Book as B_s (n x m x c) and the Depth Book as B_d
(n x H x W). Views have different numbers of patches and may differ in size, so both are kept
ragged: one long array, and where each view's part begins.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pycocotools import mask as coco_mask

from gvr_core.errors import StoreError
from gvr_core.models.base import Frame, Mask
from gvr_core.scene import View

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class _Book:
    """A set of arrays that can be put away by name and taken out again."""

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """The book's arrays by field name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> Self:
        """The book that :meth:`to_arrays` put away.

        Raises:
            StoreError: if an array is missing.
        """
        names = [f.name for f in fields(cls)]
        missing = [name for name in names if name not in arrays]
        if missing:
            raise StoreError(f"{cls.__name__} lacks {', '.join(missing)}")
        return cls(**{name: arrays[name] for name in names})


@dataclass(frozen=True, eq=False)
class _PixelBook(_Book):
    """A book of pictures: what its arrays say of all pixels, one view after the other."""

    def __len__(self) -> int:
        return len(self._sizes)

    @cached_property
    def _sizes(self) -> list[tuple[int, int]]:
        return [(int(height), int(width)) for height, width in self.sizes]  # type: ignore[attr-defined]

    @cached_property
    def _starts(self) -> list[int]:
        """Where each view's pixels begin, and where the last one's end."""
        return [0, *itertools.accumulate(height * width for height, width in self._sizes)]

    def _of_view(self, pixels: NDArray[Any], i: int) -> NDArray[Any]:
        """View i's part (H, W, ...) of an array (P, ...)."""
        part = pixels[self._starts[i] : self._starts[i + 1]]
        return part.reshape(*self._sizes[i], *pixels.shape[1:])


@dataclass(frozen=True, eq=False)
class ViewBook(_PixelBook):
    """The n rendered views, as colour pictures."""

    values: NDArray[np.uint8]
    """(P, 3) pixels of all views, one view after the other, row by row."""
    alphas: NDArray[np.uint8]
    """(P,) accumulated opacity, 255 where opaque."""
    sizes: NDArray[np.int32]
    """(n, 2) height and width of each view, pixels."""

    def rgb(self, i: int) -> NDArray[np.uint8]:
        """Picture (H, W, 3) of view i."""
        return self._of_view(self.values, i)

    def alpha(self, i: int) -> NDArray[np.uint8]:
        """Opacity (H, W) of view i."""
        return self._of_view(self.alphas, i)


@dataclass(frozen=True, eq=False)
class DepthBook(_PixelBook):
    """B_d: the z-depth of every view, expected and median."""

    expected: NDArray[np.float32]
    """(P,) sum(w z) / alpha, scene units; 0 where nothing is. The paper's depth."""
    median: NDArray[np.float32]
    """(P,) z at which the transmittance crosses 0.5; 0 where it never does. It does not bleed
    over edges, so models that look for depth edges get this one."""
    sizes: NDArray[np.int32]
    """(n, 2) height and width of each view, pixels."""

    def depth(self, i: int, kind: str = "expected") -> NDArray[np.float32]:
        """Depth (H, W) of view i; ``kind`` is ``"expected"`` or ``"median"``."""
        return self._of_view(self.expected if kind == "expected" else self.median, i)


@dataclass(frozen=True, eq=False)
class PatchBook(_Book):
    """The patches of all views: masks as run lengths (COCO), with boxes, areas and levels."""

    view_ptr: NDArray[np.int64]
    """(n + 1,) patches of view i are view_ptr[i] to view_ptr[i + 1]."""
    rle: NDArray[np.uint8]
    """(B,) compressed run lengths of all masks, one after the other."""
    rle_ptr: NDArray[np.int64]
    """(M + 1,) bytes of mask j are rle_ptr[j] to rle_ptr[j + 1]."""
    boxes: NDArray[np.int32]
    """(M, 4) tight boxes x0, y0, x1, y1, pixels, ends exclusive."""
    areas: NDArray[np.int32]
    """(M,) pixels inside each mask."""
    levels: NDArray[np.int16]
    """(M,) granularity, 0 the finest."""
    scores: NDArray[np.float32]
    """(M,) the segmenter's own confidence."""
    sizes: NDArray[np.int32]
    """(n, 2) height and width of each view, pixels."""

    def __len__(self) -> int:
        return len(self.areas)

    @property
    def n_views(self) -> int:
        """n: number of views."""
        return len(self.sizes)

    def view_of(self, patch: int) -> int:
        """Index of the view that a patch was cut from."""
        return int(np.searchsorted(self.view_ptr, patch, side="right") - 1)

    def pixels(self, patch: int) -> NDArray[np.bool_]:
        """Mask (H, W) of a patch."""
        height, width = (int(side) for side in self.sizes[self.view_of(patch)])
        counts = self.rle[self.rle_ptr[patch] : self.rle_ptr[patch + 1]].tobytes()
        decoded: NDArray[np.uint8] = coco_mask.decode({"size": [height, width], "counts": counts})
        return decoded.astype(np.bool_)

    def masks_of(self, view: int) -> list[Mask]:
        """All patches of a view."""
        return [
            Mask(self.pixels(j), float(self.scores[j]), int(self.levels[j]))
            for j in range(int(self.view_ptr[view]), int(self.view_ptr[view + 1]))
        ]

    @classmethod
    def of_masks(cls, masks: Iterable[Iterable[Mask]], sizes: Sequence[tuple[int, int]]) -> Self:
        """The book of the masks of every view.

        Args:
            masks: For each view its masks; empty masks are left out. Each view's are taken when
                the one's before are packed, so that they need not all be in memory at once.
            sizes: For each view its height and width.
        """
        counts, packed = [], []
        for view in masks:
            kept = [_packed(mask, area) for mask in view if (area := mask.area) > 0]
            counts.append(len(kept))
            packed += kept
        runs, boxes, areas, levels, scores = zip(*packed, strict=True) if packed else [()] * 5
        return cls(
            view_ptr=np.cumsum([0, *counts], dtype=np.int64),
            rle=np.frombuffer(b"".join(runs), dtype=np.uint8),
            rle_ptr=np.cumsum([0, *(len(run) for run in runs)], dtype=np.int64),
            boxes=np.array(boxes, dtype=np.int32).reshape(-1, 4),
            areas=np.array(areas, dtype=np.int32),
            levels=np.array(levels, dtype=np.int16),
            scores=np.array(scores, dtype=np.float32),
            sizes=np.array(sizes, dtype=np.int32).reshape(-1, 2),
        )


@dataclass(frozen=True, eq=False)
class SemanticVectorBook:
    """B_s: the semantic vector of every patch of every view."""

    features: NDArray[np.float16] | NDArray[np.float32]
    """(M, c) unit vectors, as kept: in half precision where preparation has made them."""
    patches: PatchBook
    """The M patches, in the same order."""

    @cached_property
    def vectors(self) -> NDArray[np.float32]:
        """(M, c) the unit vectors to compute with, in single precision."""
        return self.features.astype(np.float32, copy=False)

    def __post_init__(self) -> None:
        if self.features.ndim != 2 or len(self.features) != len(self.patches):
            raise StoreError(
                f"{len(self.patches)} patches, but semantic vectors of shape {self.features.shape}"
            )


@dataclass(frozen=True, eq=False)
class Books:
    """All that preparation knows of a scene."""

    views: ViewBook
    depths: DepthBook
    semantics: SemanticVectorBook
    index: Arrays = field(default_factory=dict)
    """What the method itself has worked out from the other books, by name."""

    @classmethod
    def none(cls) -> Self:
        """The books of a method that needs none: no view, no patch."""
        sizes = np.zeros((0, 2), np.int32)
        depths = np.zeros(0, np.float32)
        return cls(
            ViewBook(np.zeros((0, 3), np.uint8), np.zeros(0, np.uint8), sizes),
            DepthBook(depths, depths, sizes),
            SemanticVectorBook(np.zeros((0, 0), np.float32), PatchBook.of_masks([], [])),
        )


def view_frame(views: ViewBook, depths: DepthBook, i: int, view: View) -> Frame:
    """The frame of knowledge view i, as models see it.

    Args:
        views: The rendered views.
        depths: Their depths.
        i: Index of the view in the books.
        view: The view itself.
    """
    rgb = views.rgb(i).astype(np.float32) / np.float32(255)
    alpha = views.alpha(i).astype(np.float32) / np.float32(255)
    return Frame(rgb, depths.depth(i, "median"), view.camera, alpha)


def encode_rle(pixels: NDArray[np.bool_]) -> bytes:
    """Compressed COCO run lengths of a mask (H, W)."""
    counts: bytes = coco_mask.encode(np.asfortranarray(pixels, dtype=np.uint8))["counts"]
    return counts


def _packed(mask: Mask, area: int) -> tuple[bytes, tuple[int, int, int, int], int, int, float]:
    """Run lengths, box, area, level and score of a mask."""
    return encode_rle(mask.pixels), mask.box, area, mask.level, mask.score
