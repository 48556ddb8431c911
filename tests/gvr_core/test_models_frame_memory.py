"""Frames are looked at once, and only a frame of the same content is the same frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.models.base import Frame, Mask
from gvr_core.models.frame_memory import FrameMemory, SeenFrame, content_key

SIZE = (13, 17)


def frame(seed: int = 0) -> Frame:
    rng = np.random.default_rng(seed)
    camera = Camera(intrinsics(50, 17, 13), look_at((0, -3, 1), (0, 0, 0), (0, 0, 1)), 17, 13)
    rgb = rng.random((*SIZE, 3), dtype=np.float32)
    return Frame(rgb, rng.random(SIZE, dtype=np.float32), camera)


def seen(n: int = 3, seed: int = 0) -> tuple[list[Mask], SeenFrame]:
    rng = np.random.default_rng(seed)
    masks = [Mask(rng.random(SIZE) > 0.5, float(j), j) for j in range(n)]
    return masks, SeenFrame.of(masks, rng.random((n, 4), dtype=np.float32), SIZE)


def test_masks_come_back_as_they_were() -> None:
    masks, packed = seen()
    for j, mask in enumerate(masks):
        np.testing.assert_array_equal(packed.mask(j).pixels, mask.pixels)
        assert (packed.mask(j).score, packed.mask(j).level) == (mask.score, mask.level)
    assert packed.areas.tolist() == [mask.area for mask in masks]
    assert SeenFrame.of([], np.empty((0, 4), np.float32), SIZE).areas.tolist() == []


def test_a_frame_is_looked_at_once() -> None:
    memory, looks = FrameMemory(), []

    def look() -> SeenFrame:
        looks.append(1)
        return seen()[1]

    first = memory.recall(frame(), look)
    assert memory.recall(frame(), look) is first
    assert len(looks) == 1
    memory.recall(frame(1), look)
    assert len(looks) == 2


def test_the_oldest_frame_is_forgotten_first_and_the_newest_never() -> None:
    size = seen()[1].n_bytes
    memory, looks = FrameMemory(most_bytes=2 * size), []

    def ask(seed: int) -> None:
        memory.recall(frame(seed), lambda: (looks.append(seed), seen()[1])[1])

    for seed in (0, 1, 0, 2, 0, 1):
        ask(seed)
    assert looks == [0, 1, 2, 1]
    tiny = FrameMemory(most_bytes=0)
    _, only = seen()
    assert tiny.recall(frame(), lambda: only) is only
    assert tiny.recall(frame(), seen) is only  # type: ignore[arg-type]


def test_everything_in_a_frame_is_in_its_key() -> None:
    plain = frame()
    moved = replace(plain.camera, world_to_camera=look_at((0, -4, 1), (0, 0, 0), (0, 0, 1)))
    others = [
        frame(1),
        replace(plain, depth=plain.depth + 1),
        replace(plain, alpha=plain.depth),
        replace(plain, shown=np.ones(5, np.bool_)),
        replace(plain, camera=moved),
    ]
    assert len({content_key(other) for other in [plain, frame(), *others]}) == 6
