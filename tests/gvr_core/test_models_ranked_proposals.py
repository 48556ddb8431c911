"""The text segmenter made of a segmenter and an encoder."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from test_models_frames import BOXES, FRONT, camera_at, iou, trace

from gvr_core.models.base import Frame, Mask
from gvr_core.models.conse import ConseEncoder
from gvr_core.models.graph_segmenter import GraphSegmenter
from gvr_core.models.random_encoder import RandomEncoder
from gvr_core.models.ranked_proposals import RankedProposals, RankedSettings


class FixedSegmenter(GraphSegmenter):
    """Gives the masks it was told."""

    def __init__(self, masks: list[Mask]) -> None:
        super().__init__()
        self.masks = masks

    def automatic(self, frame: Frame) -> list[Mask]:
        return self.masks


class FixedEncoder(RandomEncoder):
    """Patch i has the given similarity with every text."""

    def __init__(self, similarities: Sequence[float]) -> None:
        super().__init__(0, 2)
        self.similarities = np.array(similarities, np.float32)

    def encode_patches(self, frame: Frame, masks: Sequence[Mask]) -> np.ndarray:
        s = self.similarities[: len(masks)]
        return np.stack([s, np.sqrt(1 - s**2)], axis=1)

    def encode_texts(self, texts: Sequence[str]) -> np.ndarray:
        return np.tile(np.array([[1, 0]], np.float32), (len(texts), 1))


def squares(*sides: int, levels: Sequence[int]) -> list[Mask]:
    """Masks of the given sides and levels."""
    masks = []
    for side, level in zip(sides, levels, strict=True):
        pixels = np.zeros((240, 320), np.bool_)
        pixels[:side, :side] = True
        masks.append(Mask(pixels, 0.9, level))
    return masks


def chosen(
    similarities: Sequence[float], sides: Sequence[int], levels: Sequence[int], margin: float = 0.02
) -> tuple[int, float]:
    """Area and score of the answer."""
    frame, _ = trace(FRONT)
    segmenter = FixedSegmenter(squares(*sides, levels=levels))
    ranked = RankedProposals(
        segmenter, FixedEncoder(similarities), RankedSettings(tie_margin=margin)
    )
    mask = ranked.segment(frame, "anything")
    assert mask is not None
    return mask.area, mask.score


def test_the_most_similar_proposal_wins_and_its_score_is_the_similarity() -> None:
    area, score = chosen([0.2, 0.6, 0.4], [10, 20, 30], [0, 0, 2])
    assert area == 400 and abs(score - 0.6) < 1e-6


def test_of_equals_the_whole_goes_before_its_parts() -> None:
    area, score = chosen([0.60, 0.59, 0.585, 0.5], [10, 20, 30, 90], [0, 1, 1, 2])
    assert area == 900 and abs(score - 0.585) < 1e-6
    assert chosen([0.60, 0.59], [10, 20], [0, 1], margin=0.0)[0] == 100
    assert chosen([0.5, 0.5], [10, 10], [1, 1])[0] == 100


def test_text_finds_the_box_that_shows_it() -> None:
    ranked = RankedProposals(GraphSegmenter(), ConseEncoder())
    frame, shows = trace(camera_at((0.0, -3.2, 1.4), size=(480, 360)), BOXES[:3])
    for index, text in enumerate(("a cat", "a cup of coffee")):
        mask = ranked.segment(frame, text)
        assert mask is not None and 0 < mask.score <= 1
        assert iou(mask.pixels, shows == index) > 0.9


def test_nothing_shown_gives_no_mask() -> None:
    frame, _ = trace(FRONT, (), room=False)
    assert RankedProposals(GraphSegmenter(), RandomEncoder()).segment(frame, "a cat") is None


def test_the_name_holds_both_models_and_the_settings() -> None:
    segmenter, encoder = GraphSegmenter(), RandomEncoder()
    name = RankedProposals(segmenter, encoder).name
    assert name.startswith("onboard-ranked/") and segmenter.name in name and encoder.name in name
    assert name != RankedProposals(segmenter, encoder, RankedSettings(tie_margin=0.1)).name
    assert name != RankedProposals(segmenter, RandomEncoder(1)).name
