"""Configurations of open_clip models: the library's, a user's, and what cannot be served."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

import numpy as np
import open_clip
import pytest
import torch
from pydantic import ValidationError
from tiny_open_clip import (
    TINY_MODEL,
    TinyOpenClip,
    encoder,
    unit,
    write_tiny_open_clip,
)

from gvr_core.errors import ModelError
from gvr_core.models.checkpoints import Checkpoint, checkpoint
from gvr_core.models.open_clip_config import file_config, library_config
from gvr_core.models.open_clip_encoder import OpenClipEncoder, OpenClipSettings


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> TinyOpenClip:
    return write_tiny_open_clip(tmp_path_factory.mktemp("tiny"))


def test_the_librarys_models_are_known_or_refused_by_what_they_would_look_up() -> None:
    served = 0
    for name in open_clip.list_models():
        config = open_clip.get_model_config(name)
        if config["text_cfg"].keys() & {"hf_model_name", "hf_tokenizer_name"}:
            with pytest.raises(ModelError, match=r"from the Hugging Face Hub.*tokenizer\.json"):
                library_config(name)
            continue
        found = library_config(name)
        assert found.own and found.dim == config["embed_dim"]
        assert found.size == config["vision_cfg"].get("image_size", 224)
        served += 1
    assert served > 80


def test_unknown_models_are_refused_and_close_ones_named() -> None:
    for name in ("ViT-B-61", "hf-hub:laion/CLIP", "../ViT-B-16"):
        with pytest.raises(ModelError, match=f"no model '{name}'.*open_clip.config"):
            library_config(name)
    with pytest.raises(ModelError, match="ViT-B-16"):
        library_config("ViT-B-61")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "not JSON"),
        ("[]", "no JSON object"),
        ("{}", "embed_dim is None"),
        (json.dumps(TINY_MODEL | {"embed_dim": 0}), "embed_dim is 0"),
        (json.dumps(TINY_MODEL | {"text_cfg": 3}), "text_cfg is no JSON object"),
        (json.dumps(TINY_MODEL | {"vision_cfg": {"image_size": [32, 64]}}), r"\[32, 64\].*square"),
        (
            json.dumps(TINY_MODEL | {"vision_cfg": {"timm_model_name": "hf-hub:timm/x"}}),
            "timm_model_name is 'hf-hub:timm/x'",
        ),
        (json.dumps({"model_cfg": TINY_MODEL, "preprocess_cfg": {"std": [0, 1, 1]}}), "std is"),
        (
            json.dumps({"model_cfg": TINY_MODEL, "preprocess_cfg": {"interpolation": "box"}}),
            "interpolation is 'box'.*bicubic",
        ),
    ],
)
def test_configurations_that_are_wrong_are_refused(
    content: str, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "config.json"
    path.write_text(content)
    with pytest.raises(ModelError, match=message) as error:
        file_config(path)
    assert str(path) in str(error.value)
    with pytest.raises(ModelError, match="no such file"):
        file_config(tmp_path / "absent.json")


def test_a_configuration_that_the_library_cannot_build_is_refused(
    tiny: TinyOpenClip, tmp_path: Path
) -> None:
    path = tmp_path / "config.json"
    path.write_text(json.dumps(TINY_MODEL | {"text_cfg": {"wdith": 32}}))
    settings = OpenClipSettings(config=path)
    subject = OpenClipEncoder("tiny", "mine", checkpoint(tiny.safetensors), settings, "cpu")
    with pytest.raises(ModelError, match=r"no model can be made of it.*wdith"):
        subject.encode_texts(["a cup"])


@pytest.mark.parametrize(
    "bad", [{"crops": ()}, {"crops": ("round",)}, {"fill": "grey"}, {"batch": 0}, {"presicion": 1}]
)
def test_settings_are_checked(bad: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        OpenClipSettings(**bad)


def write_words(folder: Path) -> None:
    """A tokenizer of transformers that knows a few words, in its own file."""
    from tokenizers import Tokenizer, models, pre_tokenizers
    from transformers import PreTrainedTokenizerFast

    words = ["<pad>", "<s>", "</s>", "<unk>", "a", "red", "cup", "cat", "the", "mat", "on"]
    tokenizer = Tokenizer(models.WordLevel({w: i for i, w in enumerate(words)}, "<unk>"))
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    folder.mkdir(exist_ok=True)
    PreTrainedTokenizerFast(
        tokenizer_object=tokenizer, pad_token="<pad>", eos_token="</s>", unk_token="<unk>"
    ).save_pretrained(folder)


@pytest.mark.parametrize("tower", [False, True], ids=["tokenizer", "tokenizer-and-tower"])
def test_text_towers_of_transformers_are_served_from_the_configurations_folder(
    tower: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from transformers import RobertaConfig

    monkeypatch.setattr(socket.socket, "connect", lambda *_: pytest.fail("a connection was tried"))
    write_words(tmp_path)
    texts = ["a red cup", "the cat on the mat " * 9, "a spoon"]
    text = TINY_MODEL["text_cfg"] | {"context_length": 16, "vocab_size": 12}
    text |= {"hf_tokenizer_name": "somebody/words"}
    if tower:
        sizes = {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 1}
        RobertaConfig(
            vocab_size=12, pad_token_id=0, num_attention_heads=2, **sizes
        ).save_pretrained(tmp_path)
        text = {"hf_tokenizer_name": "somebody/words", "hf_model_name": str(tmp_path)}
        text |= {"context_length": 16, "hf_proj_type": "mlp"}
    files = write_tiny_open_clip(tmp_path, model=TINY_MODEL | {"text_cfg": text})
    subject = encoder(files)
    model, _, tokenizer = files.library_model()
    with torch.inference_mode():
        expected = unit(model.encode_text(tokenizer(texts), normalize=False))
    np.testing.assert_allclose(subject.encode_texts(texts), expected, atol=1e-6)
    assert np.abs(expected[0] - expected[1]).max() > 0.01
    # The words are part of what the encoder knows.
    name = subject.name
    vocabulary = tmp_path / "tokenizer.json"
    vocabulary.write_text(vocabulary.read_text().replace('"cup"', '"mug"'))
    assert encoder(files).name != name
    vocabulary.unlink()
    with pytest.raises(ModelError, match=r"'somebody/words'.*tokenizer\.json.*same folder"):
        encoder(files)


def test_the_name_tells_everything_apart(tiny: TinyOpenClip, tmp_path: Path) -> None:
    other = write_tiny_open_clip(tmp_path, seed=1, preprocess={"mean": [0, 0, 0]})
    subjects = [
        encoder(tiny),
        encoder(tiny, other.safetensors),
        encoder(other, tiny.safetensors),
        encoder(tiny, crops=("bbox",)),
        encoder(tiny, crops=("masked", "bbox")),
        encoder(tiny, fill="mean"),
        encoder(tiny, precision="bf16"),
    ]
    assert len({subject.name for subject in subjects}) == len(subjects)
    assert encoder(tiny, batch=3).name == encoder(tiny).name
    assert f"@{checkpoint(tiny.safetensors).tag}," in encoder(tiny).name
    assert f"config@{file_config(tiny.config).tag}," in encoder(tiny).name


def test_name_and_dim_need_no_weights(tiny: TinyOpenClip, tmp_path: Path) -> None:
    weights = Checkpoint(tmp_path / "gone.safetensors", "ab" * 32)
    subject = OpenClipEncoder("ViT-B-16", "laion2b_s34b_b88k", weights, device_choice="cpu")
    assert subject.dim == 512
    assert subject.name == (
        "open_clip/1(ViT-B-16,laion2b_s34b_b88k,@abababababab,crops=masked,fill=black,"
        f"precision=fp32,open_clip_torch={open_clip.__version__})"
    )
    with pytest.raises(ModelError, match=r"gone\.safetensors"):
        subject.encode_texts(["a cup"])
