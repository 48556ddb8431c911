"""Weights: wrong digests, missing files and pickles that want to run code are refused."""

from __future__ import annotations

import hashlib
import pickle
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from gvr_core.errors import ModelError
from gvr_core.models import checkpoints, imagenet, sentence
from gvr_core.models.checkpoints import (
    installed_file,
    load_json,
    load_safetensors,
    load_torch_state,
    verified_bytes,
)


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_the_pinned_weights_are_the_installed_ones() -> None:
    pinned = {
        (imagenet.PACKAGE, imagenet.WEIGHTS_FILE): imagenet.WEIGHTS_SHA256,
        (sentence.PACKAGE, "model/model.safetensors"): sentence.WEIGHTS_SHA256,
        (sentence.PACKAGE, "model/tokenizer.json"): sentence.TOKENIZER_SHA256,
        (sentence.PACKAGE, "model/config.json"): sentence.CONFIG_SHA256,
    }
    for (package, relative), expected in pinned.items():
        assert digest(installed_file(package, relative)) == expected


def test_a_wrong_digest_is_refused_and_both_are_named(tmp_path: Path) -> None:
    path = tmp_path / "weights.bin"
    path.write_bytes(b"other weights")
    with pytest.raises(ModelError) as error:
        verified_bytes(path, "0" * 64)
    assert str(path) in str(error.value)
    assert digest(path) in str(error.value) and "0" * 64 in str(error.value)
    assert verified_bytes(path, digest(path).upper()) == b"other weights"


def test_a_missing_file_or_package_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"absent\.pth"):
        verified_bytes(tmp_path / "absent.pth", "0" * 64)
    with pytest.raises(ModelError, match="no_such_package_of_weights"):
        installed_file("no_such_package_of_weights", "a/b")


@pytest.mark.parametrize(
    ("module", "name", "build"),
    [
        (imagenet, "WEIGHTS_SHA256", imagenet.ImageNetClassifier),
        (sentence, "WEIGHTS_SHA256", sentence.SentenceEmbedder),
        (sentence, "CONFIG_SHA256", sentence.SentenceEmbedder),
        (sentence, "TOKENIZER_SHA256", sentence.SentenceEmbedder),
    ],
)
def test_models_refuse_files_that_are_not_the_pinned_ones(
    monkeypatch: pytest.MonkeyPatch,
    module,
    name: str,
    build,  # type: ignore[no-untyped-def]
) -> None:
    monkeypatch.setattr(module, name, "ab" * 32)
    with pytest.raises(ModelError, match="abab"):
        build()


def test_tensors_come_back_as_they_were_saved(tmp_path: Path) -> None:
    state = {"a": torch.arange(6.0).reshape(2, 3), "b": torch.tensor([1, 2])}
    torch.save(state, tmp_path / "a.pth")
    save_file(state, tmp_path / "a.safetensors")
    for loaded in (
        load_torch_state(tmp_path / "a.pth", digest(tmp_path / "a.pth")),
        load_safetensors(tmp_path / "a.safetensors", digest(tmp_path / "a.safetensors")),
    ):
        assert {k: v.tolist() for k, v in loaded.items()} == {
            k: v.tolist() for k, v in state.items()
        }


class Malicious:
    """Unpickling it would create a file."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[object, tuple[str, str]]:
        return (open, (str(self.target), "w"))


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
@pytest.mark.parametrize(
    "writer", [torch.save, lambda value, path: path.write_bytes(pickle.dumps(value))]
)
def test_a_pickle_that_runs_code_is_refused_before_it_does(tmp_path: Path, writer) -> None:  # type: ignore[no-untyped-def]
    path, target = tmp_path / "bad.pth", tmp_path / "created"
    writer({"weight": Malicious(target)}, path)
    with pytest.raises(ModelError, match="plain tensors"):
        load_torch_state(path, digest(path))
    assert not target.exists()


@pytest.mark.parametrize("content", [b"", b"not a checkpoint", b"PK\x03\x04 cut off"])
def test_damaged_files_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "damaged"
    path.write_bytes(content)
    for load in (load_torch_state, load_safetensors, load_json):
        with pytest.raises(ModelError, match="damaged"):
            load(path, digest(path))


def test_a_checkpoint_without_tensors_is_refused(tmp_path: Path) -> None:
    torch.save({"epoch": 3}, tmp_path / "a.pth")
    with pytest.raises(ModelError, match="no mapping of names to tensors"):
        load_torch_state(tmp_path / "a.pth", digest(tmp_path / "a.pth"))


def test_json_that_is_no_object_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("[1]")
    with pytest.raises(ModelError, match="holds a list"):
        load_json(tmp_path / "a.json", digest(tmp_path / "a.json"))


def test_finding_a_file_does_not_import_its_package() -> None:
    import sys

    sys.modules.pop(sentence.PACKAGE, None)
    checkpoints.installed_file(sentence.PACKAGE, "model/config.json")
    assert sentence.PACKAGE not in sys.modules
