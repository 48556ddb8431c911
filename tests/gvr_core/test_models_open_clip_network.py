"""open_clip models: all architectures are built, and only checkpoints that are safe and fit."""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import open_clip
import pytest
import torch
from safetensors.torch import load_file, save_file
from tiny_open_clip import (
    TEXTS,
    TINY_MODEL,
    TinyOpenClip,
    encoder,
    five_masks,
    library_model,
    library_patches,
    noise_frame,
    preprocess_val,
    shown,
    unit,
    write_tiny_open_clip,
)

from gvr_core.errors import ModelError
from gvr_core.models.base import Frame, Mask
from gvr_core.models.checkpoints import checkpoint
from gvr_core.models.open_clip_config import OpenClipConfig, file_config
from gvr_core.models.open_clip_encoder import OpenClipEncoder
from gvr_core.models.open_clip_network import load_network

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> TinyOpenClip:
    return write_tiny_open_clip(tmp_path_factory.mktemp("tiny"))


@pytest.fixture(scope="module")
def frame() -> Frame:
    return noise_frame()


@pytest.fixture(scope="module")
def masks() -> list[Mask]:
    return five_masks()


def wrap(state: dict[str, torch.Tensor], path: Path) -> None:
    parallel = {f"module.{name}": tensor for name, tensor in state.items()}
    torch.save({"epoch": 3, "state_dict": parallel}, path)


def scalar(state: dict[str, torch.Tensor], path: Path) -> None:
    sizes = {name: torch.tensor(77) for name in ("input_resolution", "context_length")}
    save_file(state | sizes | {"logit_scale": torch.ones(1)}, path)


@pytest.mark.parametrize(
    ("write", "suffix"), [(torch.save, ".pt"), (wrap, ".pt"), (scalar, ".safetensors")]
)
def test_checkpoints_of_all_forms_give_the_same(
    write: Callable[[dict[str, torch.Tensor], Path], None],
    suffix: str,
    tiny: TinyOpenClip,
    tmp_path: Path,
    frame: Frame,
    masks: list[Mask],
) -> None:
    path = tmp_path / f"other{suffix}"
    write(load_file(tiny.safetensors), path)
    other, first = encoder(tiny, path), encoder(tiny)
    assert np.array_equal(other.encode_patches(frame, masks), first.encode_patches(frame, masks))
    assert np.array_equal(other.encode_texts(TEXTS), first.encode_texts(TEXTS))


def test_older_checkpoints_are_converted_by_the_librarys_helpers(
    tiny: TinyOpenClip, tmp_path: Path, frame: Frame, masks: list[Mask]
) -> None:
    # The text tower at the top level, as before custom text towers, and more positions.
    model = TINY_MODEL | {"custom_text": True}
    model["vision_cfg"] = model["vision_cfg"] | {"image_size": 48}
    files = write_tiny_open_clip(tmp_path, seed=9, model=model)
    expected = library_model(f"local-dir:{tmp_path}")
    open_clip.load_checkpoint(expected, str(tiny.safetensors))
    subject = encoder(files, tiny.safetensors)
    preprocess = files.library_model()[1]
    batch = torch.stack([preprocess(shown(frame, mask, "masked", (0, 0, 0))) for mask in masks])
    with torch.inference_mode():
        vectors = unit(expected.encode_image(batch))
    np.testing.assert_allclose(subject.encode_patches(frame, masks), vectors, atol=1e-6)
    np.testing.assert_allclose(
        subject.encode_texts(TEXTS), encoder(tiny).encode_texts(TEXTS), atol=1e-6
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s.pop("visual.proj"), r"missing: visual\.proj"),
        (lambda s: s.update({"visual.extra": torch.ones(2)}), r"not in the model: visual\.extra"),
        (lambda s: s.update({"visual.proj": torch.ones(64, 9)}), r"another shape: visual\.proj"),
        (
            lambda s: [s.pop(name) for name in list(s) if name.startswith("transformer.")],
            r"missing: transformer\.resblocks\.0\.\w.* and 21 more",
        ),
        (lambda s: s.update({"positional_embedding": torch.ones(77, 5)}), "does not fit tiny"),
    ],
    ids=["missing", "extra", "shape", "many", "positions"],
)
def test_a_checkpoint_of_another_model_is_refused(
    change: Callable[[dict[str, torch.Tensor]], object],
    message: str,
    tiny: TinyOpenClip,
    tmp_path: Path,
) -> None:
    state = load_file(tiny.safetensors)
    change(state)
    path = tmp_path / "other.safetensors"
    save_file(state, path)
    with pytest.raises(ModelError, match=message) as error:
        encoder(tiny, path).encode_texts(["a cup"])
    assert str(path) in str(error.value) and "accepted: a checkpoint of tiny" in str(error.value)


class Malicious:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.path,)


def test_pickles_that_run_code_are_refused(tiny: TinyOpenClip, tmp_path: Path) -> None:
    path, mark = tmp_path / "evil.pt", tmp_path / "it-ran"
    for write in (torch.save, lambda value, to: to.write_bytes(pickle.dumps(value))):
        write({"visual.proj": Malicious(mark)}, path)
        with pytest.raises(ModelError, match="refused, as reading it might run code"):
            encoder(tiny, path).encode_texts(["a cup"])
        assert not mark.exists()


def test_torchscript_is_refused_and_another_source_named(
    tiny: TinyOpenClip, tmp_path: Path
) -> None:
    path = tmp_path / "ViT-B-16.pt"
    torch.jit.script(torch.nn.Linear(2, 2)).save(str(path))
    with pytest.raises(ModelError, match=r"TorchScript.*\.safetensors or as a plain state dict"):
        encoder(tiny, path).encode_texts(["a cup"])
    official = OpenClipEncoder("ViT-B-16", "openai", checkpoint(path), device_choice="cpu")
    with pytest.raises(ModelError, match=r"huggingface\.co/timm/vit_base_patch16_clip_224\.openai"):
        official.encode_texts(["a cup"])


def test_a_training_brings_its_own_colours_and_activation(tiny: TinyOpenClip) -> None:
    own = OpenClipConfig(TINY_MODEL, tiny.config)
    weights = checkpoint(tiny.safetensors)
    clip_a = load_network(own, ("ViT-L-14-CLIPA", "datacomp1b"), weights, "fp32", CPU)
    assert clip_a.interpolation == "bilinear" and clip_a.mean == (0.485, 0.456, 0.406)
    quick = load_network(own, ("ViT-B-16", "openai"), weights, "fp32", CPU)
    plain = load_network(own, ("ViT-B-16", "laion2b_s34b_b88k"), weights, "fp32", CPU)
    assert quick.mean == plain.mean == (0.48145466, 0.4578275, 0.40821073)
    assert "QuickGELU" in str(quick.model) and "QuickGELU" not in str(plain.model)
    # A user's own configuration stands as it is.
    mine = load_network(file_config(tiny.config), ("ViT-B-16", "openai"), weights, "fp32", CPU)
    assert "QuickGELU" not in str(mine.model)


def test_configurations_do_not_leak(
    tiny: TinyOpenClip, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    known = open_clip.list_models()
    wide = write_tiny_open_clip(tmp_path, model=TINY_MODEL | {"embed_dim": 48})
    handlers = list(logging.getLogger().handlers)
    with caplog.at_level(logging.DEBUG):
        assert encoder(wide).encode_texts(TEXTS).shape == (3, 48)
        assert encoder(tiny).encode_texts(TEXTS).shape == (3, 32)
    assert open_clip.list_models() == known
    # Nor does what the library says of a model whose weights are yet to come.
    assert not [record for record in caplog.records if "random" in record.getMessage()]
    assert logging.getLogger().handlers == handlers


VARIANTS: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "quick-gelu": lambda m: m | {"quick_gelu": True},
    "custom-text": lambda m: m | {"custom_text": True},
    "resnet": lambda m: (
        m | {"vision_cfg": {"image_size": 64, "layers": [1, 1, 1, 1], "width": 8, "head_width": 16}}
    ),
    "timm": lambda m: (
        m | {"vision_cfg": {"image_size": 64, "timm_model_name": "resnet10t", "timm_proj": "mlp"}}
    ),
    "coca": lambda m: (
        m
        | {
            "custom_text": True,
            "vision_cfg": m["vision_cfg"]
            | {"attentional_pool": True, "attn_pooler_queries": 4, "output_tokens": True},
            "text_cfg": m["text_cfg"]
            | {"context_length": 76, "embed_cls": True, "output_tokens": True},
            "multimodal_cfg": {"context_length": 76, "width": 32, "heads": 2, "layers": 1}
            | {"vocab_size": 49408, "attn_pooler_heads": 2, "mlp_ratio": 4},
        }
    ),
}


@pytest.mark.parametrize("kind", VARIANTS)
def test_all_of_the_librarys_architectures_are_served(
    kind: str, tmp_path: Path, frame: Frame, masks: list[Mask]
) -> None:
    files = write_tiny_open_clip(tmp_path, model=VARIANTS[kind](TINY_MODEL))
    subject = encoder(files)
    expected = unit(library_patches(files, frame, masks, "masked"))
    np.testing.assert_allclose(subject.encode_patches(frame, masks), expected, atol=2e-6)
    model, _, tokenizer = files.library_model()
    with torch.inference_mode():
        texts = unit(model.encode_text(tokenizer(TEXTS), normalize=False))
    np.testing.assert_allclose(subject.encode_texts(TEXTS), texts, atol=1e-6)


def test_vit_b_16_at_its_real_size(tmp_path: Path, frame: Frame, masks: list[Mask]) -> None:
    path = tmp_path / "b16.safetensors"
    model = library_model("ViT-B-16")
    save_file(model.half().state_dict(), path)
    model.float()
    subject = OpenClipEncoder("ViT-B-16", "laion2b_s34b_b88k", checkpoint(path), None, "cpu")
    vectors = subject.encode_patches(frame, masks[:4])
    assert vectors.shape == (4, subject.dim) == (4, 512)
    picture = preprocess_val(model)(shown(frame, masks[0], "masked", (0, 0, 0)))
    with torch.inference_mode():
        expected = unit(model.encode_image(picture[None]))
    np.testing.assert_allclose(vectors[:1], expected, atol=1e-5)
    assert subject.encode_texts(["a cup"]).shape == (1, 512)
