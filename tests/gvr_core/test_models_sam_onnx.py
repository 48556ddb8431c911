"""SAM as ONNX graphs: the same masks as through torch, and right ones on real photographs."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from numpy.typing import NDArray
from outlines import Outline, photograph, read_outlines
from skimage import data
from skimage.transform import resize
from tiny_sam import export_tiny_sam, photograph_frame, save_tiny_sam

from gvr_core.errors import ModelError
from gvr_core.models import full_strength
from gvr_core.models.base import BoolArray, Mask
from gvr_core.models.checkpoints import checkpoint
from gvr_core.models.sam_onnx import OnnxSam
from gvr_core.models.sam_prompts import SparseSamSettings, picture_logits
from gvr_core.models.sam_segmenter import SamSegmenter
from gvr_core.models.sam_torch import TorchSam

LENIENT = SparseSamSettings(
    points_per_side=4, pred_iou=0.6, stability=0.3, nms_iou=1, min_area=20, same_iou=1
)


def iou(one: BoolArray, other: BoolArray) -> float:
    return float((one & other).sum() / (one | other).sum())


def onnx_segmenter(folder: Path, settings: SparseSamSettings = LENIENT) -> SamSegmenter:
    return SamSegmenter(OnnxSam(*OnnxSam.files(folder)), settings)


@pytest.fixture(scope="module", params=[True, False], ids=["chooses", "gives-all"])
def exported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_tiny_sam(tmp_path_factory.mktemp("onnx"), chooses=request.param)


@pytest.fixture(scope="module")
def picture() -> NDArray[np.uint8]:
    return np.rint(resize(data.coffee(), (100, 150), anti_aliasing=True) * 255).astype(np.uint8)


def nearly_equal(ours: Mask, theirs: Mask) -> None:
    """Both compute in single precision, in another order: a border pixel may fall either way."""
    assert (ours.pixels != theirs.pixels).sum() <= 3
    assert ours.score == pytest.approx(theirs.score, abs=1e-4)
    assert ours.level == theirs.level


def test_graphs_give_what_torch_gives(
    exported: Path, tmp_path: Path, picture: NDArray[np.uint8]
) -> None:
    frame = photograph_frame(picture)
    ours = onnx_segmenter(exported)
    torch_sam = TorchSam(checkpoint(save_tiny_sam(tmp_path / "tiny.pth")), device="cpu")
    theirs = SamSegmenter(torch_sam, LENIENT)
    for point in [(70.0, 50.0), (3.5, 2.0), (149.0, 99.0)]:
        for one, other in zip(
            ours.masks_at(frame, point), theirs.masks_at(frame, point), strict=True
        ):
            nearly_equal(one, other)
    points, inside = [(70.0, 50.0), (10.0, 10.0)], [True, False]
    nearly_equal(ours.at_points(frame, points, inside), theirs.at_points(frame, points, inside))
    box = (20.0, 10.0, 90.0, 80.0)
    nearly_equal(ours.in_box(frame, box), theirs.in_box(frame, box))
    everything = ours.automatic(frame), theirs.automatic(frame)
    assert len(everything[0]) == len(everything[1]) > 10
    for one, other in zip(*everything, strict=True):
        nearly_equal(one, other)


@pytest.fixture(scope="module")
def mobile_sam(shared: Path) -> Path:
    return shared / "models" / "mobile_sam"


@pytest.fixture(scope="module")
def real(mobile_sam: Path) -> SamSegmenter:
    return onnx_segmenter(mobile_sam, SparseSamSettings())


OUTLINES = {outline.thing: outline for outline in read_outlines()}


@pytest.mark.parametrize("thing", ["spoon", "cat", "helmet"])
def test_a_click_finds_the_thing(real: SamSegmenter, thing: str) -> None:
    outline = OUTLINES[thing]
    mask = real.at_point(photograph_frame(photograph(outline)), outline.point)
    assert iou(mask.pixels, outline.mask) >= 0.75


@pytest.mark.parametrize("outline", OUTLINES.values(), ids=OUTLINES)
def test_one_of_the_three_masks_of_a_click_is_the_thing(
    real: SamSegmenter, outline: Outline
) -> None:
    masks = real.masks_at(photograph_frame(photograph(outline)), outline.point)
    assert max(iou(mask.pixels, outline.mask) for mask in masks) >= 0.75


SAUCER = [(130.5, 200.5), (420.5, 220.5), (250.5, 340.5)]
"""Left of, right of, and before the cup, which is of the saucer's colour."""


@pytest.mark.parametrize("saucer", SAUCER)
def test_a_second_click_tells_the_cup_from_its_saucer(
    real: SamSegmenter, saucer: tuple[float, float]
) -> None:
    """The click on the cup alone is taken to mean the cup with its saucer."""
    cup = OUTLINES["cup"]
    frame = photograph_frame(photograph(cup))
    mask = real.at_points(frame, [cup.point, saucer], [True, False])
    assert iou(mask.pixels, cup.mask) >= 0.75
    assert iou(real.at_point(frame, cup.point).pixels, cup.mask) < iou(mask.pixels, cup.mask)


@pytest.mark.parametrize("outline", OUTLINES.values(), ids=OUTLINES)
def test_a_box_finds_the_thing(real: SamSegmenter, outline: Outline) -> None:
    box = Mask(outline.mask).box
    mask = real.in_box(photograph_frame(photograph(outline)), box)
    assert iou(mask.pixels, outline.mask) >= 0.75


def test_the_mask_that_the_whole_graph_chooses_is_one_of_ours(mobile_sam: Path) -> None:
    outline = OUTLINES["cat"]
    sam = OnnxSam(*OnnxSam.files(mobile_sam))
    embedding = sam.embed(photograph(outline))
    scale = 1024 / outline.width
    whole = onnxruntime.InferenceSession(mobile_sam / "sam.onnx")
    masks, score, _ = whole.run(
        None,
        {
            "image_embeddings": embedding.features,
            "point_coords": np.array([[np.array(outline.point) * scale, (0, 0)]], np.float32),
            "point_labels": np.array([[1, -1]], np.float32),
            "mask_input": np.zeros((1, 1, 256, 256), np.float32),
            "has_mask_input": np.zeros(1, np.float32),
            "orig_im_size": np.array([outline.height, outline.width], np.float32),
        },
    )
    points = np.array([[outline.point]], np.float32)
    logits, scores = sam.decode_points(embedding, points, np.ones((1, 1), np.int64))
    best = int(scores[0].argmax())
    ours = picture_logits(logits[:, best : best + 1], embedding, sam.side)[0, 0].numpy()
    assert float(scores[0, best]) == pytest.approx(float(score[0, 0]), abs=1e-4)
    assert ((ours > 0) != (masks[0, 0] > 0)).sum() <= 20


def test_the_folder_is_found_under_the_models_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    export_tiny_sam(tmp_path / "models" / "tiny", chooses=True)
    monkeypatch.setenv("GVR_MODELS", str(tmp_path / "models"))
    found = full_strength.sam_onnx("tiny", LENIENT)
    assert found.name == full_strength.sam_onnx(str(tmp_path / "models" / "tiny"), LENIENT).name
    assert found.name.startswith("sam-onnx/1:")


def test_graphs_that_are_missing_or_others_are_refused(
    exported: Path, tmp_path: Path, picture: NDArray[np.uint8]
) -> None:
    def refusal(folder: Path) -> str:
        with pytest.raises(ModelError) as error:
            onnx_segmenter(folder).at_point(photograph_frame(picture), (5.0, 5.0))
        assert str(tmp_path) in str(error.value)
        return str(error.value)

    broken = Path(shutil.copytree(exported, tmp_path / "broken"))
    (broken / "decoder.onnx").unlink()
    assert "decoder.onnx" in refusal(broken)
    (broken / "decoder.onnx").write_bytes(b"not a graph")
    assert "decoder.onnx" in refusal(broken)
    shutil.copy(exported / "encoder.onnx", broken / "decoder.onnx")
    assert "low_res_masks" in refusal(broken)
    shutil.copy(exported / "decoder.onnx", broken / "encoder.onnx")
    assert "one input of shape" in refusal(broken)


def test_weights_in_further_files_are_refused(
    exported: Path, tmp_path: Path, picture: NDArray[np.uint8]
) -> None:
    """Their digests would not be in the name, and their paths might lead anywhere."""
    folder = Path(shutil.copytree(exported, tmp_path / "outside"))
    for name in ("encoder.onnx", "decoder.onnx"):
        graph = onnx.load(folder / name)
        onnx.save(graph, folder / name, save_as_external_data=True, size_threshold=0)
        with pytest.raises(ModelError, match=rf"{name}.*other files"):
            onnx_segmenter(folder).at_point(photograph_frame(picture), (5.0, 5.0))
        shutil.copy(exported / name, folder / name)


def test_a_graph_that_changes_between_its_name_and_its_loading_is_refused(
    exported: Path, tmp_path: Path, picture: NDArray[np.uint8]
) -> None:
    folder = Path(shutil.copytree(exported, tmp_path / "changing"))
    made = onnx_segmenter(folder)
    (folder / "encoder.onnx").write_bytes(b"another")
    with pytest.raises(ModelError, match=r"encoder\.onnx.*sha256"):
        made.automatic(photograph_frame(picture))
