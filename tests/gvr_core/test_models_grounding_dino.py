"""Grounding DINO: the library's own boxes, as prompts of a segmenter, out of local files only."""

from __future__ import annotations

import json
import logging
import pickle
import shutil
import socket
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from pydantic import ValidationError
from safetensors.torch import save_file
from test_models_frames import FRONT, trace
from tiny_grounding_dino import SIDE, TinyGroundingDino, write_tiny_grounding_dino
from torchvision.ops import box_convert

from gvr_core.errors import ConfigError, ModelError
from gvr_core.models import grounding_dino_network
from gvr_core.models.base import Frame, Mask
from gvr_core.models.bert_folder import bert_folder
from gvr_core.models.checkpoints import checkpoint, installed_file
from gvr_core.models.crops import to_uint8
from gvr_core.models.grounded_segmenter import GroundedSegmenter, grounded
from gvr_core.models.grounding_dino import Boxes, GroundingDino
from gvr_core.models.grounding_dino_config import (
    MEMORY_TRICKS,
    VARIANTS,
    GroundingDinoSettings,
    configuration,
)

# The library, called directly, speaks of what will change in those that it stands on.
pytestmark = [
    pytest.mark.filterwarnings("ignore::FutureWarning"),
    pytest.mark.filterwarnings("ignore:torch.meshgrid"),
]

TEXT = "a red cup"

State = dict[str, torch.Tensor]


@pytest.fixture(scope="module", autouse=True)
def one_core() -> Iterator[None]:
    """Networks this small gain nothing from more, and wait for them on a busy machine."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> TinyGroundingDino:
    return write_tiny_grounding_dino(tmp_path_factory.mktemp("tiny") / "model")


@pytest.fixture(scope="module")
def library(tiny: TinyGroundingDino) -> Any:
    """The same files through the library's own loader."""
    from groundingdino.util.inference import load_model

    return load_model(str(tiny.config), str(tiny.checkpoint), device="cpu")


@pytest.fixture(scope="module")
def frame() -> Frame:
    return trace(FRONT)[0]


@dataclass
class BoxFiller:
    """Fills the box that it is asked for, or finds nothing in any."""

    blind: bool = False
    asked: list[tuple[float, float, float, float]] = field(default_factory=list)
    name: str = "box-filler"

    def automatic(self, frame: Frame) -> list[Mask]:
        raise NotImplementedError

    def at_point(self, frame: Frame, point: tuple[float, float]) -> Mask:
        raise NotImplementedError

    def in_box(self, frame: Frame, box: tuple[float, float, float, float]) -> Mask:
        self.asked.append(box)
        pixels = np.zeros(frame.depth.shape, np.bool_)
        if not self.blind:
            pixels[int(box[1]) : int(box[3]) + 1, int(box[0]) : int(box[2]) + 1] = True
        return Mask(pixels, 0.123, 1)


def detector(tiny: TinyGroundingDino, variant: str = "swin_t", **changes: Any) -> GroundingDino:
    settings = tiny.settings(**changes)
    assert settings.checkpoint and settings.bert
    weights, bert = checkpoint(settings.checkpoint), bert_folder(settings.bert)
    return GroundingDino(variant, weights, bert, settings, "cpu")


def predicted(
    library: Any, rgb8: np.ndarray, text: str, threshold: float = 0.0
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Boxes in pixels, scores and phrases as the library's own functions give them."""
    import groundingdino.datasets.transforms as T
    from groundingdino.util.inference import predict

    transform = T.Compose(
        [
            T.RandomResize([SIDE], max_size=2 * SIDE),
            T.ToTensor(),
            T.Normalize([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]),
        ]
    )
    picture, _ = transform(Image.fromarray(rgb8), None)
    boxes, scores, phrases = predict(library, picture, text, threshold, threshold, "cpu")
    height, width = rgb8.shape[:2]
    corners = box_convert(boxes * torch.tensor([width, height, width, height]), "cxcywh", "xyxy")
    inside = np.clip(corners.numpy(), 0, [width, height, width, height])
    return inside.astype(np.float32), scores.numpy(), phrases


@pytest.mark.parametrize("text", [TEXT, "  The CAT. spoon", "cups?", "unheard-of words."])
def test_boxes_and_scores_are_those_of_the_librarys_own_predictor(
    tiny: TinyGroundingDino, library: Any, frame: Frame, text: str
) -> None:
    own = detector(tiny)
    rgb8 = to_uint8(frame.rgb)
    for picture in (rgb8, rgb8[:, :110], np.ascontiguousarray(rgb8[:40])):
        found = own.find(picture, text)
        corners, scores, _ = predicted(library, picture, text)
        assert len(scores) == 20 and np.ptp(scores) > 0.05
        assert np.array_equal(found.scores, scores)
        assert np.array_equal(found.corners, corners)


def test_only_boxes_above_both_thresholds_count(
    tiny: TinyGroundingDino, library: Any, frame: Frame
) -> None:
    rgb8 = to_uint8(frame.rgb)
    corners, scores, _ = predicted(library, rgb8, TEXT)
    low, high = (float(score) for score in np.sort(scores)[[5, 12]])
    kept, kept_scores, phrases = predicted(library, rgb8, TEXT, high)
    assert len(kept_scores) == 7 and all(phrases)
    for changes, threshold in (
        ({"box_threshold": high}, high),
        ({"text_threshold": high}, high),
        ({"box_threshold": low, "text_threshold": high}, high),
        ({"box_threshold": low, "text_threshold": 0.0}, low),
    ):
        found = detector(tiny, **changes).find(rgb8, TEXT)
        assert np.array_equal(found.scores, scores[scores > np.float32(threshold)])
        assert np.array_equal(found.corners, corners[scores > np.float32(threshold)])
    assert np.array_equal(detector(tiny, box_threshold=high).find(rgb8, TEXT).corners, kept)


def test_the_mask_is_the_segmenters_in_the_best_box(tiny: TinyGroundingDino, frame: Frame) -> None:
    filler = BoxFiller()
    found = detector(tiny).find(to_uint8(frame.rgb), TEXT)
    mask = grounded("swin_t", tiny.settings(), "cpu", filler).segment(frame, TEXT)
    best = tuple(float(edge) for edge in found.corners[found.scores.argmax()])
    assert mask is not None and filler.asked == [best]
    expected = BoxFiller().in_box(frame, best)
    assert np.array_equal(mask.pixels, expected.pixels)
    assert mask.score == found.scores.max() and mask.level == expected.level


def test_all_boxes_together_make_the_union(tiny: TinyGroundingDino, frame: Frame) -> None:
    filler = BoxFiller()
    found = detector(tiny).find(to_uint8(frame.rgb), TEXT)
    threshold = float(np.sort(found.scores)[-4])
    settings = tiny.settings(keep="all", box_threshold=threshold)
    mask = grounded("swin_t", settings, "cpu", filler).segment(frame, TEXT)
    boxes = found.corners[found.scores > threshold].tolist()
    assert mask is not None and sorted(map(list, filler.asked)) == sorted(boxes)
    assert len(boxes) == 3
    union = np.logical_or.reduce([BoxFiller().in_box(frame, tuple(b)).pixels for b in boxes])
    assert np.array_equal(mask.pixels, union) and mask.score == found.scores.max()
    assert mask.area > max(BoxFiller().in_box(frame, tuple(b)).area for b in boxes)


def test_nothing_found_gives_no_mask(tiny: TinyGroundingDino, frame: Frame) -> None:
    filler = BoxFiller()
    assert (
        grounded("swin_t", tiny.settings(box_threshold=1.0), "cpu", filler).segment(frame, TEXT)
        is None
    )
    assert not filler.asked
    for keep in ("best", "all"):
        blind = BoxFiller(blind=True)
        settings = tiny.settings(keep=keep)
        assert grounded("swin_t", settings, "cpu", blind).segment(frame, TEXT) is None
        assert len(blind.asked) == (1 if keep == "best" else 20)


class FixedDetector(GroundingDino):
    """Gives the boxes it was told."""

    name = "fixed"

    def __init__(self, boxes: Boxes) -> None:
        self._boxes = boxes

    def find(self, rgb8: np.ndarray, text: str) -> Boxes:
        return self._boxes


def test_of_equal_boxes_the_first_is_taken(frame: Frame) -> None:
    corners = np.array([[0, 0, 5, 5], [10, 10, 30, 20], [40, 10, 60, 20]], np.float32)
    boxes = Boxes(corners, np.array([0.4, 0.7, 0.7], np.float32))
    filler = BoxFiller()
    mask = GroundedSegmenter(FixedDetector(boxes), filler).segment(frame, TEXT)
    assert mask is not None and filler.asked == [(10.0, 10.0, 30.0, 20.0)]
    assert mask.score == pytest.approx(0.7)


@pytest.mark.parametrize("text", ["", "  \n", ".", " . ? "])
def test_a_text_without_words_is_refused(tiny: TinyGroundingDino, frame: Frame, text: str) -> None:
    with pytest.raises(ModelError, match="names nothing"):
        grounded("swin_t", tiny.settings(), "cpu", BoxFiller()).segment(frame, text)


def test_a_text_that_is_too_long_is_cut_and_that_is_said(
    tiny: TinyGroundingDino, library: Any, frame: Frame, caplog: pytest.LogCaptureFixture
) -> None:
    own, rgb8 = detector(tiny), to_uint8(frame.rgb)
    with caplog.at_level(logging.WARNING):
        own.find(rgb8, "cup")
        assert "tokens" not in caplog.text
        found = own.find(rgb8, "cat " * 299)
    assert "302 tokens, of which Grounding DINO reads the first 256" in caplog.text
    assert len(found.scores) == 20


def test_a_picture_with_too_few_places_for_the_queries_is_refused(tiny: TinyGroundingDino) -> None:
    own = detector(tiny, shorter_side=32, longest_side=64)
    assert len(own.find(np.zeros((20, 60, 3), np.uint8), TEXT).scores) == 20
    for shape, places in (((2, 60, 3), 15), ((1, 5000, 3), 0)):
        with pytest.raises(ModelError, match=f"gives {places} places .*at least 20"):
            own.find(np.zeros(shape, np.uint8), TEXT)


def test_out_of_memory_is_said(
    tiny: TinyGroundingDino, frame: Frame, monkeypatch: pytest.MonkeyPatch
) -> None:
    def exhausted(*_: Any) -> None:
        raise MemoryError

    own = detector(tiny)
    monkeypatch.setattr(own, "_forward", exhausted)
    with pytest.raises(ModelError, match="runs out of memory"):
        own.find(to_uint8(frame.rgb), TEXT)


def test_threads_get_what_they_would_get_alone(tiny: TinyGroundingDino, frame: Frame) -> None:
    rgb8 = to_uint8(frame.rgb)
    pictures = [rgb8, rgb8[:, :120], rgb8[:90], rgb8[:, :200]] * 2
    alone = detector(tiny)
    expected = [alone.find(picture, TEXT) for picture in pictures]
    grounding_dino_network.shared_network.cache_clear()
    fresh = detector(tiny)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda picture: fresh.find(picture, TEXT), pictures))
    for one, other in zip(found, expected, strict=True):
        assert np.allclose(one.scores, other.scores, atol=1e-5)
        assert np.allclose(one.corners, other.corners, atol=1e-3)


def test_the_network_sees_one_picture_at_a_time(
    tiny: TinyGroundingDino, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its backbone remembers the size of the picture, whichever thread that came from."""
    inside, most = 0, 0
    forward = GroundingDino._forward

    def watched(*given: Any) -> Any:
        nonlocal inside, most
        inside += 1
        most = max(most, inside)
        time.sleep(0.05)
        try:
            return forward(*given)
        finally:
            inside -= 1

    monkeypatch.setattr(GroundingDino, "_forward", watched)
    several = [detector(tiny, box_threshold=threshold) for threshold in (0.1, 0.2, 0.3)]
    with ThreadPoolExecutor(3) as pool:
        picture = np.zeros((90, 90, 3), np.uint8)
        found = list(pool.map(lambda each: each.find(picture, TEXT), several))
    assert len(found) == 3 and most == 1


def test_detectors_of_the_same_files_share_one_network(
    tiny: TinyGroundingDino, monkeypatch: pytest.MonkeyPatch
) -> None:
    built = []
    build = grounding_dino_network._built
    monkeypatch.setattr(
        grounding_dino_network, "_built", lambda *given: built.append(1) or build(*given)
    )
    grounding_dino_network.shared_network.cache_clear()
    picture = np.zeros((90, 90, 3), np.uint8)
    for threshold in (0.1, 0.2):
        detector(tiny, box_threshold=threshold).find(picture, TEXT)
    assert len(built) == 1


def test_the_network_is_not_touched(
    tiny: TinyGroundingDino,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    asked: list[str] = []

    def refuse(*given: Any, **_: Any) -> Any:
        asked.append(repr(given))
        raise OSError("no network here")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    monkeypatch.delenv("HF_HUB_OFFLINE", raising=False)
    monkeypatch.setenv("HF_HOME", str(tmp_path))
    grounding_dino_network.shared_network.cache_clear()
    capfd.readouterr()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("default")
        detector(tiny).find(np.zeros((90, 90, 3), np.uint8), TEXT)
    assert not asked and not list(tmp_path.iterdir())
    # Nor is anything printed or warned of.
    assert capfd.readouterr() == ("", "")
    assert [str(warning.message) for warning in said] == []


def test_the_library_is_left_as_it_was(tiny: TinyGroundingDino, library: Any) -> None:
    from groundingdino.util import get_tokenlizer

    grounding_dino_network.shared_network.cache_clear()
    detector(tiny).find(np.zeros((90, 90, 3), np.uint8), TEXT)
    for function in (
        get_tokenlizer.get_tokenlizer,
        get_tokenlizer.get_pretrained_language_model,
    ):
        assert function.__module__ == "groundingdino.util.get_tokenlizer"


# Files


def test_the_name_holds_every_file_and_setting(tiny: TinyGroundingDino, tmp_path: Path) -> None:
    filler = BoxFiller()

    def name(**changes: Any) -> str:
        return grounded("swin_t", tiny.settings(**changes), "cpu", filler).name

    first = name()
    assert first.startswith("grounded_sam/1(swin_t@") and first.endswith(",box-filler)")
    assert checkpoint(tiny.checkpoint).tag in first and "groundingdino-py=0.4.0" in first
    other_weights, other_bert = tmp_path / "other.pth", tmp_path / "bert"
    torch.save({"model": {"weight": torch.zeros(1)}}, other_weights)
    shutil.copytree(tiny.bert, other_bert)
    (tmp_path / "other.toml").write_text("num_queries = 10\n")
    assert name(bert=other_bert) == first
    (other_bert / "tokenizer_config.json").write_text('{"do_lower_case": false}')
    changes: list[dict[str, Any]] = [
        {"checkpoint": other_weights},
        {"bert": other_bert},
        {"config": tmp_path / "other.toml"},
        {"config": None},
        {"box_threshold": 0.1},
        {"text_threshold": 0.1},
        {"shorter_side": 100},
        {"longest_side": 400},
        {"keep": "all"},
    ]
    names = {first, *(name(**change) for change in changes)}
    names.add(grounded("swin_b", tiny.settings(), "cpu", filler).name)
    names.add(grounded("swin_t", tiny.settings(), "cpu", BoxFiller(name="other")).name)
    assert len(names) == len(changes) + 3


def test_an_unknown_variant_is_refused_with_those_that_are_known(tiny: TinyGroundingDino) -> None:
    with pytest.raises(
        ConfigError, match=r"'swin_l'; did you mean .* \(accepted: swin_b, swin_t\)"
    ):
        grounded("swin_l", tiny.settings(), "cpu", BoxFiller())


def test_files_that_are_not_there_are_named_with_the_command_that_fetches_them(
    tiny: TinyGroundingDino, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("GVR_MODELS", str(tmp_path / "models"))
    for changes, missing in (
        ({"checkpoint": None}, "gvr models fetch grounded_sam:swin_t"),
        ({"bert": None}, "gvr models fetch bert-base-uncased"),
        ({"bert": tmp_path / "no_bert"}, "no_bert.*gvr models fetch bert-base-uncased"),
        ({"checkpoint": tmp_path / "absent.pth"}, r"absent\.pth"),
    ):
        with pytest.raises(ModelError, match=missing):
            grounded("swin_t", tiny.settings(**changes), "cpu", BoxFiller())


@pytest.mark.parametrize("lacking", [("config.json",), ("vocab.txt", "tokenizer.json")])
def test_an_incomplete_bert_folder_is_refused(
    tiny: TinyGroundingDino, tmp_path: Path, lacking: tuple[str, ...]
) -> None:
    shutil.copytree(tiny.bert, tmp_path / "bert")
    for name in lacking:
        (tmp_path / "bert" / name).unlink()
    with pytest.raises(ModelError, match=f"lacks .*{lacking[0]}.*gvr models fetch bert"):
        grounded("swin_t", tiny.settings(bert=tmp_path / "bert"), "cpu", BoxFiller())


def _drop_question_mark(bert: Path) -> None:
    (bert / "tokenizer.json").unlink()
    words = (bert / "vocab.txt").read_text().split("\n")
    (bert / "vocab.txt").write_text("\n".join("!" if word == "?" else word for word in words))


def _shrink(bert: Path) -> None:
    sizes = json.loads((bert / "config.json").read_text())
    (bert / "config.json").write_text(json.dumps(sizes | {"vocab_size": 5}))


def _other_width(bert: Path) -> None:
    sizes = json.loads((bert / "config.json").read_text())
    (bert / "config.json").write_text(json.dumps(sizes | {"hidden_size": 64}))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda bert: (bert / "config.json").write_text("[]"), "no JSON object"),
        (lambda bert: (bert / "config.json").write_text('{"model_type": "roberta"}'), "roberta"),
        (lambda bert: (bert / "config.json").write_text('{"hidden_size": "wide"}'), "no BERT"),
        (lambda bert: (bert / "tokenizer.json").write_text("{"), "no tokenizer can be made"),
        (_drop_question_mark, r"lacks \?"),
        (_shrink, "vocab_size = 5"),
        (_other_width, r"word_embeddings\.weight \(\d+, 32\) for \(\d+, 64\)"),
    ],
)
def test_a_wrong_bert_folder_is_refused(
    tiny: TinyGroundingDino, tmp_path: Path, change: Callable[[Path], Any], said: str
) -> None:
    shutil.copytree(tiny.bert, tmp_path / "bert")
    change(tmp_path / "bert")
    with pytest.raises(ModelError, match=said):
        detector(tiny, bert=tmp_path / "bert").find(np.zeros((90, 90, 3), np.uint8), TEXT)


def test_a_bert_folder_that_changes_before_it_is_read_is_refused(
    tiny: TinyGroundingDino, tmp_path: Path
) -> None:
    shutil.copytree(tiny.bert, tmp_path / "bert")
    own = detector(tiny, bert=tmp_path / "bert")
    (tmp_path / "bert" / "added_tokens.json").write_text("{}")
    with pytest.raises(ModelError, match="have changed"):
        own.find(np.zeros((90, 90, 3), np.uint8), TEXT)


def _without(*names: str) -> Callable[[State], State]:
    return lambda state: {k: v for k, v in state.items() if k not in names}


def _with(**tensors: torch.Tensor) -> Callable[[State], State]:
    return lambda state: state | {name.replace("__", "."): t for name, t in tensors.items()}


def load(tiny: TinyGroundingDino, path: Path) -> Boxes:
    return detector(tiny, checkpoint=path).find(np.zeros((90, 90, 3), np.uint8), TEXT)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            _without("feat_map.bias", "transformer.level_embed"),
            r"lacks transformer\.level_embed, feat_map\.bias",
        ),
        (
            lambda state: {k: v for k, v in state.items() if not k.startswith("bert.")},
            r"lacks bert\.embeddings\.word_embeddings\.weight, .* and \d+ more",
        ),
        (_with(surprise__weight=torch.zeros(2)), r"has unknown surprise\.weight"),
        (_with(feat_map__bias=torch.zeros(7)), r"feat_map\.bias \(7,\) for \(256,\)"),
    ],
)
def test_a_checkpoint_of_another_model_is_refused(
    tiny: TinyGroundingDino, tmp_path: Path, change: Callable[[State], State], said: str
) -> None:
    state = torch.load(tiny.checkpoint, weights_only=True)["model"]
    torch.save({"model": change(state)}, tmp_path / "other.pth")
    with pytest.raises(ModelError, match=said) as error:
        load(tiny, tmp_path / "other.pth")
    assert str(tmp_path / "other.pth") in str(error.value)


def test_what_published_checkpoints_hold_besides_is_passed_over(
    tiny: TinyGroundingDino, tmp_path: Path
) -> None:
    """They come from a parallel training, with an embedding of its own and an old buffer."""
    state = torch.load(tiny.checkpoint, weights_only=True)["model"]
    state["label_enc.weight"] = torch.zeros(2001, 256)
    state["bert.embeddings.position_ids"] = torch.arange(256)[None]
    torch.save({"model": {f"module.{k}": v for k, v in state.items()}}, tmp_path / "full.pth")
    assert np.array_equal(
        load(tiny, tmp_path / "full.pth").scores, load(tiny, tiny.checkpoint).scores
    )


def test_safetensors_without_second_names_and_computed_buffers_is_enough(
    tiny: TinyGroundingDino, tmp_path: Path
) -> None:
    state = torch.load(tiny.checkpoint, weights_only=True)["model"]
    second = ("transformer.decoder.bbox_embed.", "bbox_embed.1.")
    kept = {
        name: tensor
        for name, tensor in state.items()
        if not name.startswith(second) and not name.endswith("relative_position_index")
    }
    assert len(state) - len(kept) > 12
    save_file(kept, tmp_path / "tiny.safetensors")
    assert np.array_equal(
        load(tiny, tmp_path / "tiny.safetensors").scores, load(tiny, tiny.checkpoint).scores
    )


class Malicious:
    """Unpickling it would create a file."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[object, tuple[str, str]]:
        return (open, (str(self.target), "w"))


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
def test_a_checkpoint_that_would_run_code_is_refused(
    tiny: TinyGroundingDino, tmp_path: Path
) -> None:
    path, target = tmp_path / "bad.pth", tmp_path / "created"
    torch.save({"model": {"feat_map.bias": Malicious(target)}}, path)
    with pytest.raises(ModelError, match="might run code"):
        load(tiny, path)
    path.write_bytes(pickle.dumps(Malicious(target)))
    with pytest.raises(ModelError, match=r"bad\.pth"):
        load(tiny, path)
    assert not target.exists()


# Configuration


@pytest.mark.parametrize("variant", sorted(VARIANTS))
def test_the_keys_are_those_that_the_library_reads_itself(variant: str) -> None:
    from groundingdino.util.slconfig import SLConfig

    file = installed_file("groundingdino", VARIANTS[variant])
    own = SLConfig.fromfile(str(file))._cfg_dict.to_dict()
    del own["text_encoder_type"]
    keys = configuration(variant)
    assert keys == own | dict.fromkeys(MEMORY_TRICKS, False)
    assert keys["backbone"] == {"swin_b": "swin_B_384_22k", "swin_t": "swin_T_224_1k"}[variant]


def test_a_file_of_keys_goes_before_the_variants(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("num_queries = 12\nfusion_droppath = 0\n")
    (tmp_path / "a.json").write_text('{"num_queries": 12, "fusion_droppath": 0}')
    expected = configuration("swin_b") | {"num_queries": 12, "fusion_droppath": 0}
    assert configuration("swin_b", tmp_path / "a.toml") == expected
    assert configuration("swin_b", tmp_path / "a.json") == expected


def test_a_python_file_of_keys_is_refused_and_not_run(
    tiny: TinyGroundingDino, tmp_path: Path
) -> None:
    path = tmp_path / "keys.py"
    path.write_text(f"open({str(tmp_path / 'created')!r}, 'w')\nnum_queries = 12\n")
    with pytest.raises(ConfigError, match=r"keys\.py: .*would run it.*\.json or \.toml"):
        grounded("swin_t", tiny.settings(config=path), "cpu", BoxFiller())
    assert not (tmp_path / "created").exists()


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.yaml", "", "its kind is unknown"),
        ("a.json", "{", "cannot be parsed"),
        ("a.json", "[1]", "holds a list"),
        ("a.toml", "num_querys = 3", "num_querys"),
        ("a.toml", "num_queries = 3.5", "key 'num_queries': 3.5 is of type float"),
        ("a.toml", "num_queries = true", "of type bool"),
        ("a.toml", 'backbone = "resnet50"', "resnet50.*swin_T_224_1k"),
        ("a.toml", 'modelname = "other"', "accepted: groundingdino"),
    ],
)
def test_keys_that_cannot_be_used_are_refused(
    tmp_path: Path, name: str, content: str, said: str
) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(ConfigError, match=said):
        configuration("swin_t", tmp_path / name)


def test_an_absent_file_of_keys_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"absent\.toml.*No such file"):
        configuration("swin_t", tmp_path / "absent.toml")


def test_keys_that_the_library_cannot_build_are_refused(
    tiny: TinyGroundingDino, tmp_path: Path
) -> None:
    keys = json.loads(tiny.config.read_text())
    (tmp_path / "a.json").write_text(json.dumps(keys | {"return_interm_indices": [0, 2]}))
    with pytest.raises(ModelError, match="builds no Grounding DINO of these keys: AssertionError"):
        detector(tiny, config=tmp_path / "a.json").find(np.zeros((90, 90, 3), np.uint8), TEXT)


@pytest.mark.parametrize(
    "values",
    [
        {"box_threshold": 1.5},
        {"text_threshold": -0.1},
        {"keep": "some"},
        {"shorter_side": 900, "longest_side": 800},
        {"thresholds": 0.3},
    ],
)
def test_impossible_settings_are_refused(values: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        GroundingDinoSettings(**values)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"dec_layers": 3}, r"lacks transformer\.decoder\.layers\.2"),
        ({"dec_layers": 1}, r"has unknown transformer\.decoder\.layers\.1"),
        (
            {"backbone": "swin_B_384_22k"},
            r"input_proj\.0\.0\.weight \(256, 192, .* for \(256, 256, ",
        ),
    ],
)
def test_a_checkpoint_of_other_keys_is_refused(
    tiny: TinyGroundingDino, tmp_path: Path, keys: dict[str, Any], said: str
) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps(json.loads(tiny.config.read_text()) | keys))
    with pytest.raises(ModelError, match=said):
        detector(tiny, config=path).find(np.zeros((90, 90, 3), np.uint8), TEXT)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.slow
def test_computing_twice_to_save_memory_changes_no_result(
    tiny: TinyGroundingDino, frame: Frame, tmp_path: Path
) -> None:
    """The library's configurations ask for it; here it is off (slow, as it loads a compiler)."""
    from groundingdino.util.inference import load_model

    keys = json.loads(tiny.config.read_text()) | dict.fromkeys(MEMORY_TRICKS, True)
    (tmp_path / "a.json").write_text(json.dumps(keys))
    library = load_model(str(tmp_path / "a.json"), str(tiny.checkpoint), device="cpu")
    rgb8 = to_uint8(frame.rgb)
    found = detector(tiny, config=tmp_path / "a.json").find(rgb8, TEXT)
    corners, scores, _ = predicted(library, rgb8, TEXT)
    assert np.allclose(found.scores, scores, atol=1e-5)
    assert np.allclose(found.corners, corners, atol=1e-3)
