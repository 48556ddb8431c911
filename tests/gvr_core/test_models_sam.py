"""SAM through its own library: what it gives is what the library's own predictor gives."""

from __future__ import annotations

import logging
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from segment_anything import SamAutomaticMaskGenerator, SamPredictor, sam_model_registry
from skimage import data
from skimage.transform import resize
from tiny_sam import CHANNELS, photograph_frame, save_tiny_sam, tiny_sam

from gvr_core.errors import ModelError
from gvr_core.models import full_strength
from gvr_core.models.base import Frame, Mask
from gvr_core.models.checkpoints import checkpoint
from gvr_core.models.sam_architecture import VARIANTS, SamArchitecture
from gvr_core.models.sam_automatic import LEVELS
from gvr_core.models.sam_prompts import SamSettings, SparseSamSettings
from gvr_core.models.sam_segmenter import SamSegmenter
from gvr_core.models.sam_torch import TorchSam

HEIGHT, WIDTH = 100, 150
LENIENT = SamSettings(
    points_per_side=6, pred_iou=0.6, stability=0.3, nms_iou=0.97, min_area=20, same_iou=1
)
"""A random network's masks are nearly the same everywhere; these settings let some pass."""
POINTS = [(70.0, 50.0), (3.5, 2.0), (149.0, 99.0), (20.25, 80.5)]


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_tiny_sam(tmp_path_factory.mktemp("sam") / "tiny.pth")


@pytest.fixture(scope="module")
def picture() -> NDArray[np.uint8]:
    small = resize(data.coffee(), (HEIGHT, WIDTH), anti_aliasing=True)
    return np.rint(small * 255).astype(np.uint8)


@pytest.fixture(scope="module")
def predictor(picture: NDArray[np.uint8]) -> SamPredictor:
    predictor = SamPredictor(tiny_sam())
    predictor.set_image(picture)
    return predictor


def frame_of(rgb8: NDArray[np.uint8], depth: float = 1.0) -> Frame:
    """A render, all of which shows something."""
    return photograph_frame(rgb8, depth)


def segmenter(weights: Path, settings: SamSettings = LENIENT) -> SamSegmenter:
    return SamSegmenter(TorchSam(checkpoint(weights), device="cpu"), settings)


@pytest.mark.parametrize("point", POINTS)
def test_a_point_gives_what_the_library_gives(
    weights: Path, picture: NDArray[np.uint8], predictor: SamPredictor, point: tuple[float, float]
) -> None:
    masks, scores, _ = predictor.predict(np.array([point]), np.array([1]))
    ours = segmenter(weights).masks_at(frame_of(picture), point)
    assert [mask.level for mask in ours] == [0, 1, 2]
    for mask, expected, score in zip(ours, masks, scores, strict=True):
        np.testing.assert_array_equal(mask.pixels, expected)
        assert mask.score == pytest.approx(float(score), abs=1e-6)
    best = segmenter(weights).at_point(frame_of(picture), point)
    np.testing.assert_array_equal(best.pixels, masks[scores.argmax()])
    assert best.area > 0


def test_several_points_give_the_one_mask_of_a_clear_prompt(
    weights: Path, picture: NDArray[np.uint8], predictor: SamPredictor
) -> None:
    points, inside = [(70.0, 50.0), (10.0, 10.0), (75.5, 30.0)], [True, False, True]
    expected, scores, _ = predictor.predict(
        np.array(points), np.array(inside, int), multimask_output=False
    )
    ours = segmenter(weights).at_points(frame_of(picture), points, inside)
    np.testing.assert_array_equal(ours.pixels, expected[0])
    assert ours.score == pytest.approx(float(scores[0]), abs=1e-6)


@pytest.mark.parametrize("box", [(20, 10, 90, 80), (0, 0, WIDTH, HEIGHT), (60.5, 40.25, 70, 51)])
def test_a_box_gives_what_the_library_gives(
    weights: Path, picture: NDArray[np.uint8], predictor: SamPredictor, box: tuple[float, ...]
) -> None:
    expected, scores, _ = predictor.predict(box=np.array(box), multimask_output=False)
    ours = segmenter(weights).in_box(frame_of(picture), box)  # type: ignore[arg-type]
    np.testing.assert_array_equal(ours.pixels, expected[0])
    assert ours.score == pytest.approx(float(scores[0]), abs=1e-6)


class OneLevel(SamPredictor):
    """Test double: the library's predictor, of whose three masks only one is passed on."""

    def __init__(self, model: Any, level: int) -> None:
        super().__init__(model)
        self._level = level

    def predict_torch(self, *args: Any, **kwargs: Any) -> Any:
        masks, scores, low = super().predict_torch(*args, **kwargs)
        one = slice(self._level, self._level + 1)
        return masks[:, one], scores[:, one], low[:, one]


@pytest.mark.parametrize(
    ("crop_layers", "nms_iou", "seed", "least"), [(0, 1, 1, 20), (1, 1, 0, 20), (1, 0.97, 0, 2)]
)
def test_automatic_masks_of_a_level_are_those_of_the_librarys_generator(
    tmp_path: Path,
    picture: NDArray[np.uint8],
    crop_layers: int,
    nms_iou: float,
    seed: int,
    least: int,
) -> None:
    model = tiny_sam(seed)
    settings = LENIENT.model_copy(
        update={"crop_layers": crop_layers, "nms_iou": nms_iou, "points_per_side": 5}
    )
    path = save_tiny_sam(tmp_path / "tiny.pth", seed)
    ours = segmenter(path, settings).automatic(frame_of(picture))
    found = 0
    for level in range(LEVELS):
        generator = SamAutomaticMaskGenerator(
            model,
            points_per_side=settings.points_per_side,
            pred_iou_thresh=settings.pred_iou,
            stability_score_thresh=settings.stability,
            stability_score_offset=settings.stability_offset,
            box_nms_thresh=settings.nms_iou,
            crop_nms_thresh=settings.nms_iou,
            crop_n_layers=crop_layers,
            min_mask_region_area=settings.min_area,
        )
        generator.predictor = OneLevel(model, level)
        try:
            expected = [m for m in generator.generate(picture) if m["segmentation"].any()]
        except IndexError:  # the library fails where a crop, or the picture, has no mask at all
            continue
        mine = [mask for mask in ours if mask.level == level]
        assert len(mine) == len(expected)
        for mask, theirs in zip(mine, expected, strict=True):
            np.testing.assert_array_equal(mask.pixels, theirs["segmentation"])
            assert mask.score == pytest.approx(theirs["predicted_iou"], abs=1e-6)
        found += len(mine)
    assert found >= least, "too little was compared"


def test_a_picture_is_embedded_once_for_many_prompts(
    weights: Path, picture: NDArray[np.uint8], monkeypatch: pytest.MonkeyPatch
) -> None:
    sam = TorchSam(checkpoint(weights), device="cpu")
    embedded: list[int] = []
    embed = sam.embed
    monkeypatch.setattr(sam, "embed", lambda rgb8: (embedded.append(1), embed(rgb8))[1])
    asked = SamSegmenter(sam, LENIENT)
    for point in POINTS:
        asked.at_point(frame_of(picture), point)
    asked.in_box(frame_of(picture), (1, 2, 30, 40))
    assert len(embedded) == 1
    asked.at_point(frame_of(picture[:, ::-1]), POINTS[0])
    assert len(embedded) == 2


def test_points_outside_of_the_picture_find_nothing(
    weights: Path, picture: NDArray[np.uint8]
) -> None:
    for point in [(-0.1, 5.0), (WIDTH, 5.0), (5.0, HEIGHT + 3.0)]:
        mask = segmenter(weights).at_point(frame_of(picture), point)
        assert mask.area == 0 and mask.score == 0 and mask.pixels.shape == (HEIGHT, WIDTH)


def test_only_what_a_render_shows_is_asked(
    weights: Path, picture: NDArray[np.uint8], monkeypatch: pytest.MonkeyPatch
) -> None:
    sam = TorchSam(checkpoint(weights), device="cpu")
    asked: list[NDArray[Any]] = []
    decode = sam.decode_points

    def watched(embedding: Any, points: NDArray[Any], labels: NDArray[Any]) -> Any:
        asked.append(points[:, 0])
        return decode(embedding, points, labels)

    monkeypatch.setattr(sam, "decode_points", watched)
    settings = LENIENT.model_copy(update={"crop_layers": 0})
    frame = frame_of(picture)
    frame.depth[:, WIDTH // 2 :] = 0
    SamSegmenter(sam, settings).automatic(frame)
    points = np.concatenate(asked)
    assert len(points) == 18 and points[:, 0].max() < WIDTH / 2
    asked.clear()
    SamSegmenter(sam, settings).automatic(frame_of(picture, depth=0.0))
    assert len(np.concatenate(asked)) == 36, "a photograph has no depth, and is asked everywhere"


def test_no_mask_at_all_is_an_empty_list(weights: Path, picture: NDArray[np.uint8]) -> None:
    strict = LENIENT.model_copy(update={"stability": 1.0, "pred_iou": 1.0, "crop_layers": 1})
    assert segmenter(weights, strict).automatic(frame_of(picture)) == []


def test_copies_at_a_finer_level_are_left_out(weights: Path, picture: NDArray[np.uint8]) -> None:
    frame = frame_of(picture)
    every = segmenter(weights).automatic(frame)
    fewer = segmenter(weights, LENIENT.model_copy(update={"same_iou": 0.5})).automatic(frame)

    def iou(a: Mask, b: Mask) -> float:
        return float((a.pixels & b.pixels).sum() / (a.pixels | b.pixels).sum())

    assert 0 < len(fewer) < len(every)
    for mask in fewer:
        assert all(iou(mask, other) <= 0.5 for other in fewer if other.level > mask.level)


def test_out_of_memory_halves_the_prompts_and_changes_nothing(
    weights: Path,
    picture: NDArray[np.uint8],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    expected = segmenter(weights).automatic(frame_of(picture))
    sam = TorchSam(checkpoint(weights), device="cpu")
    decode, sizes = sam.decode_points, []

    def small(embedding: Any, points: NDArray[Any], labels: NDArray[Any]) -> Any:
        sizes.append(len(points))
        if len(points) > 10:
            raise torch.cuda.OutOfMemoryError("CUDA out of memory (pretended by the test)")
        return decode(embedding, points, labels)

    monkeypatch.setattr(sam, "decode_points", small)
    with caplog.at_level(logging.WARNING):
        found = SamSegmenter(sam, LENIENT).automatic(frame_of(picture))
    assert sizes[:3] == [36, 18, 9] and max(sizes[2:]) <= 9
    assert "ran out of memory with 36 prompts" in caplog.text
    assert [mask.area for mask in found] == [mask.area for mask in expected]
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.pixels, other.pixels)


def test_threads_share_one_loading_and_agree(weights: Path, picture: NDArray[np.uint8]) -> None:
    shared = segmenter(weights)
    alone = [segmenter(weights).at_point(frame_of(picture), point) for point in POINTS]
    together: dict[int, Mask] = {}

    def ask(i: int) -> None:
        together[i] = shared.at_point(frame_of(picture), POINTS[i])

    threads = [threading.Thread(target=ask, args=(i,)) for i in range(len(POINTS))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i, mask in enumerate(alone):
        np.testing.assert_array_equal(together[i].pixels, mask.pixels)


@pytest.mark.parametrize("variant", sorted(VARIANTS))
def test_the_published_models_are_known_by_their_tensors(variant: str) -> None:
    """On the meta device, which has shapes and no numbers: ViT-H has 641 million of those."""
    with torch.device("meta"):
        theirs = sam_model_registry[variant]().state_dict()
        architecture = SamArchitecture.of_state(theirs, Path("published"))
        ours = architecture.build().state_dict()
    assert (architecture.width, architecture.depth) == VARIANTS[variant]
    assert (architecture.side, architecture.window, architecture.n_masks) == (1024, 14, 3)
    assert {k: v.shape for k, v in ours.items()} == {k: v.shape for k, v in theirs.items()}
    heads = {"vit_b": 12, "vit_l": 16, "vit_h": 16}[variant]
    assert architecture.heads == heads and len(architecture.global_blocks) == 4


def test_weights_that_are_no_sam_are_refused(tmp_path: Path, picture: NDArray[np.uint8]) -> None:
    state = tiny_sam().state_dict()

    def refusal(broken: dict[str, torch.Tensor], variant: str | None = None) -> str:
        path = tmp_path / "broken.pth"
        torch.save(broken, path)
        with pytest.raises(ModelError) as error:
            TorchSam(checkpoint(path), variant, "cpu").embed(picture)
        assert str(path) in str(error.value)
        return str(error.value)

    assert "there is no image_encoder.patch_embed" in refusal({"a": torch.zeros(3)})
    gone = "mask_decoder.iou_token.weight"
    assert gone in refusal({k: v for k, v in state.items() if k != gone})
    wide = {gone: torch.zeros(1, CHANNELS + 1)}
    assert gone in refusal(state | wide)
    assert "accepted: 768 and 12 for vit_b" in refusal(state, "vit_b")


def test_names_hold_the_weights_and_the_settings(tmp_path: Path, weights: Path) -> None:
    other = save_tiny_sam(tmp_path / "other.pth", seed=5)
    names = [
        segmenter(weights).name,
        segmenter(other).name,
        segmenter(weights, LENIENT.model_copy(update={"stability": 0.31})).name,
    ]
    assert len(set(names)) == 3 and all(name.startswith("sam/1:local@") for name in names)
    batches = LENIENT.model_copy(update={"points_at_once": 7})
    assert segmenter(weights, batches).name == names[0], "batches change no result"


def test_a_file_can_stand_in_for_a_published_model(weights: Path) -> None:
    made = full_strength.sam(str(weights), LENIENT, "cpu")
    assert made is full_strength.sam(str(weights), LENIENT, "cpu")
    assert made.name == segmenter(weights).name
    with pytest.raises(ModelError, match=r"sam:vit_h"):
        full_strength.sam("vit_x", LENIENT, "cpu")
    with pytest.raises(ModelError, match=r"absent\.pth"):
        full_strength.sam("absent.pth", LENIENT, "cpu")


def test_a_published_model_that_is_not_there_names_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GVR_MODELS", str(tmp_path))
    with pytest.raises(ModelError, match=r"gvr models fetch sam:vit_h"):
        full_strength.sam("vit_h", SamSettings(), "cpu")
    with pytest.raises(ModelError, match=r"encoder\.onnx"):
        full_strength.sam_onnx("no_such_folder", SparseSamSettings())
