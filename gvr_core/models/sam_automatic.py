"""Automatic masks of a SAM at three levels: a grid of points, then the good and the different.

It follows segment_anything.SamAutomaticMaskGenerator step by step, with that library's own
functions, but keeps the three masks of a prompt apart as LangSplat (CVPR 2024) does: a mask is
compared only with masks of its own level.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pycocotools import mask as coco_mask

from gvr_core.models.base import BoolArray, Mask
from gvr_core.models.devices import Batches
from gvr_core.models.sam_prompts import (
    MASK_THRESHOLD,
    PromptableSam,
    SamSettings,
    picture_logits,
)

if TYPE_CHECKING:
    import torch

LEVELS = 3
"""Masks of a prompt: a part of a part, a part, the whole."""


@dataclass(frozen=True, eq=False)
class _Found:
    """Masks of one level, run-length encoded: a dense grid finds thousands."""

    runs: list[Any]
    boxes: torch.Tensor
    """(m, 4) float32 x0, y0, x1, y1 of the first and the last pixel inside, whole picture."""
    scores: torch.Tensor
    """(m,) predicted IoU."""
    crop_areas: torch.Tensor
    """(m,) area of the crop that each was found in."""

    def __len__(self) -> int:
        return len(self.runs)

    def __getitem__(self, keep: torch.Tensor) -> _Found:
        runs = [self.runs[int(i)] for i in keep]
        return _Found(runs, self.boxes[keep], self.scores[keep], self.crop_areas[keep])

    @classmethod
    def join(cls, parts: Sequence[_Found]) -> _Found:
        import torch

        return cls(
            [run for part in parts for run in part.runs],
            torch.cat([part.boxes for part in parts]),
            torch.cat([part.scores for part in parts]),
            torch.cat([part.crop_areas for part in parts]),
        )


def automatic_masks(
    sam: PromptableSam,
    rgb8: NDArray[np.uint8],
    settings: SamSettings,
    prompts: Batches,
    shown: BoolArray | None = None,
) -> list[Mask]:
    """All masks of a picture.

    Args:
        sam: The networks.
        rgb8: (H, W, 3) uint8.
        settings: Grid and limits.
        prompts: How many points are asked at once.
        shown: (H, W) where there is something to ask for; None for everywhere.

    Returns:
        Masks by level, finest first; within a level in the order that the last suppression of
        overlaps leaves. Scores are the predicted IoU.
    """
    from segment_anything.utils.amg import build_all_layer_point_grids, generate_crop_boxes

    height, width = rgb8.shape[:2]
    crops, layers = generate_crop_boxes(
        (height, width), settings.crop_layers, settings.crop_overlap
    )
    grids = build_all_layer_point_grids(
        settings.points_per_side, settings.crop_layers, settings.crop_points_divisor
    )
    found: list[list[_Found]] = [[] for _ in range(LEVELS)]
    for crop, layer in zip(crops, layers, strict=True):
        for level, part in enumerate(
            _in_crop(sam, rgb8, crop, grids[layer], settings, prompts, shown)
        ):
            found[level].append(part)
    masks = []
    for level, parts in enumerate(found):
        whole = _Found.join(parts)
        if len(parts) > 1:
            # What a small crop shows large is drawn more finely there.
            whole = whole[_suppress(whole.boxes, 1 / whole.crop_areas, settings.nms_iou)]
        masks += _cleaned(whole, level, settings)
    return _without_copies(masks, settings.same_iou)


def _in_crop(
    sam: PromptableSam,
    rgb8: NDArray[np.uint8],
    crop: Sequence[int],
    grid: NDArray[np.float64],
    settings: SamSettings,
    prompts: Batches,
    shown: BoolArray | None,
) -> Iterator[_Found]:
    """What one crop shows, level by level."""
    import torch

    x0, y0, x1, y1 = crop
    points = grid * (x1 - x0, y1 - y0)
    if shown is not None:
        x, y = points.astype(np.int64).T
        points = points[shown[y0:y1, x0:x1][y, x]]
    batches: list[list[_Found]] = []
    if len(points):
        embedding = sam.embed(np.ascontiguousarray(rgb8[y0:y1, x0:x1]))

        def ask(batch: NDArray[np.float64]) -> list[_Found]:
            inside = np.ones((len(batch), 1), np.int64)
            logits, scores = sam.decode_points(embedding, batch[:, None], inside)
            found = []
            for level in range(LEVELS):
                good = scores[:, level] > settings.pred_iou
                full = picture_logits(logits[good, level : level + 1], embedding, sam.side)
                judged = _judged(full[:, 0], scores[good, level], crop, rgb8.shape, settings)
                found.append(judged)
            return found

        batches = prompts.run(ask, points, sam.device)
    nothing = _Found([], torch.empty((0, 4)), torch.empty(0), torch.empty(0))
    for level in range(LEVELS):
        whole = _Found.join([nothing, *(batch[level] for batch in batches)])
        yield whole[_suppress(whole.boxes, whole.scores, settings.nms_iou)]


def _judged(
    logits: torch.Tensor,
    scores: torch.Tensor,
    crop: Sequence[int],
    picture: tuple[int, ...],
    settings: SamSettings,
) -> _Found:
    """The masks of a batch that are stable and do not end where the crop does."""
    from segment_anything.utils.amg import (
        batched_mask_to_box,
        calculate_stability_score,
        is_box_near_crop_edge,
        uncrop_boxes_xyxy,
        uncrop_masks,
    )

    height, width = picture[:2]
    stability = calculate_stability_score(logits, MASK_THRESHOLD, settings.stability_offset)
    keep = stability >= settings.stability
    pixels, scores = logits[keep] > MASK_THRESHOLD, scores[keep]
    boxes = batched_mask_to_box(pixels)
    whole = ~is_box_near_crop_edge(boxes, list(crop), [0, 0, width, height])
    pixels, scores, boxes = pixels[whole], scores[whole], boxes[whole]
    full = uncrop_masks(pixels, list(crop), height, width).cpu().numpy()
    runs = [coco_mask.encode(np.asfortranarray(mask, np.uint8)) for mask in full]
    area = float((crop[2] - crop[0]) * (crop[3] - crop[1]))
    return _Found(
        runs,
        uncrop_boxes_xyxy(boxes, list(crop)).float().cpu(),
        scores.float().cpu(),
        scores.new_full((len(runs),), area).float().cpu(),
    )


def _suppress(boxes: torch.Tensor, scores: torch.Tensor, iou: float) -> torch.Tensor:
    """Indices that non-maximum suppression of boxes keeps, the highest score first."""
    import torch
    from torchvision.ops import nms

    kept: torch.Tensor = nms(boxes, scores, iou) if len(boxes) else torch.empty(0).long()
    return kept


def _cleaned(found: _Found, level: int, settings: SamSettings) -> list[Mask]:
    """Masks with small holes closed and small islands removed, and again without doubles."""
    import torch
    from segment_anything.utils.amg import batched_mask_to_box, remove_small_regions

    pixels = [coco_mask.decode(run).astype(np.bool_) for run in found.runs]
    scores = [float(score) for score in found.scores]
    order: Sequence[int] = range(len(pixels))
    if settings.min_area and pixels:
        untouched = []
        for i, mask in enumerate(pixels):
            closed, had_holes = remove_small_regions(mask, settings.min_area, mode="holes")
            pixels[i], had_islands = remove_small_regions(closed, settings.min_area, mode="islands")
            untouched.append(float(not (had_holes or had_islands)))
        # One at a time: thousands of full pictures side by side would not fit.
        boxes = [batched_mask_to_box(torch.as_tensor(mask)[None])[0] for mask in pixels]
        kept = _suppress(torch.stack(boxes).float(), torch.tensor(untouched), settings.nms_iou)
        order = [int(i) for i in kept]
    masks = [Mask(pixels[i].astype(np.bool_), scores[i], level) for i in order]
    return [mask for mask in masks if mask.pixels.any()]


def _without_copies(masks: list[Mask], same_iou: float) -> list[Mask]:
    """Masks that are not also there, nearly alike, at a coarser level."""
    if same_iou >= 1 or len(masks) < 2:
        return masks
    runs = [coco_mask.encode(np.asfortranarray(mask.pixels, np.uint8)) for mask in masks]
    overlap = np.asarray(coco_mask.iou(runs, runs, [0] * len(runs)))
    levels = np.array([mask.level for mask in masks])
    kept: list[int] = []
    for i in np.argsort(-levels, kind="stable"):
        coarser = [j for j in kept if levels[j] > levels[i]]
        if not coarser or overlap[i, coarser].max() <= same_iou:
            kept.append(int(i))
    return [masks[i] for i in sorted(kept)]
