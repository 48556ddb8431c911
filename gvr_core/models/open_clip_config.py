"""What an open_clip model is made of: its JSON configuration, and no weights yet."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from gvr_core.errors import ModelError
from gvr_core.models.checkpoints import installed_file
from gvr_core.models.transformers_files import NETWORK_CONFIG, TOKENIZER_OPTIONS, VOCABULARIES
from gvr_core.untrusted import expanded, parse_json, read_regular

_FORMAT = 'open_clip\'s JSON: {"embed_dim": 512, "vision_cfg": {...}, "text_cfg": {...}}'
_DEFAULT_SIZE = 224


@dataclass(frozen=True, eq=False)
class OpenClipConfig:
    """An architecture as open_clip describes it."""

    model: Mapping[str, Any]
    """``embed_dim``, ``vision_cfg``, ``text_cfg`` and more, as ``open_clip.model`` takes them."""
    source: Path
    """The JSON file."""
    own: bool = True
    """Whether the library brings it; else it is a file of the user's."""
    preprocess: Mapping[str, Any] = field(default_factory=dict)
    """``mean``, ``std``, ``interpolation``, where the file states them."""
    text_files: Mapping[str, bytes] = field(default_factory=dict)
    """Tokenizer and network configuration of a text tower that open_clip takes from
    ``transformers``, by file name."""
    sha256: str = ""
    """Digest over all of a user's files."""

    @property
    def tag(self) -> str:
        """The digest, as short as model names show it."""
        return self.sha256[:12]

    @property
    def dim(self) -> int:
        """c: length of a semantic vector."""
        return int(self.model["embed_dim"])

    @property
    def size(self) -> int:
        """Side of the square pictures that the model takes, pixels."""
        size = self.model["vision_cfg"].get("image_size", _DEFAULT_SIZE)
        return int(size if isinstance(size, int) else size[0])


def library_config(model_name: str) -> OpenClipConfig:
    """The configuration of a model that open_clip knows by name.

    It is read from the installed package without importing it, which takes seconds.

    Args:
        model_name: E.g. ``"ViT-B-16"``.

    Raises:
        ModelError: for a name that the library does not list, or a model whose text tower it
            would look up on the Hugging Face Hub.
    """
    folder = installed_file("open_clip", "model_configs")
    known = sorted(path.stem for path in folder.glob("*.json"))
    if model_name not in known:
        close = get_close_matches(model_name, known, n=6, cutoff=0.3)
        raise ModelError(
            f"open_clip has no model {model_name!r}",
            accepted=f"{', '.join(close or known[:6])}, another of its {len(known)} models, or "
            "a JSON configuration (open_clip.config)",
        )
    path = folder / f"{model_name}.json"
    model, _ = _read(path, path.read_bytes())
    if needs := _looked_up(model):
        raise ModelError(
            f"{model_name} takes {needs} from the Hugging Face Hub, and nothing is looked up here",
            accepted="a model with CLIP's own tokenizer; or open_clip.config, the path of the "
            f"model's JSON in a folder that also holds {_wanted(model)}",
        )
    return OpenClipConfig(model, path)


def file_config(path: Path) -> OpenClipConfig:
    """A configuration from a JSON file.

    Both of open_clip's formats are taken: the bare one of its ``model_configs`` and the one of
    ``open_clip_config.json``, with ``model_cfg`` and ``preprocess_cfg``. The files of a tokenizer
    or a text tower of ``transformers`` are taken from the same folder.

    Args:
        path: The file.

    Raises:
        ModelError: if it or a file that it needs is missing or is not what it should be.
    """
    path = expanded(path).absolute()
    content = _content(path)
    if content is None:
        raise ModelError("no such file", path=path, accepted=_FORMAT)
    model, preprocess = _read(path, content)
    files: dict[str, bytes] = {}
    if needs := _looked_up(model):
        names = (NETWORK_CONFIG, *VOCABULARIES, *TOKENIZER_OPTIONS)
        found = {name: _content(path.parent / name) for name in names}
        files = {name: part for name, part in found.items() if part is not None}
        if not files.keys() & set(VOCABULARIES) or (
            "hf_model_name" in model["text_cfg"] and NETWORK_CONFIG not in files
        ):
            raise ModelError(
                f"the model takes {needs} from the Hugging Face Hub, and nothing is looked up here",
                path=path,
                accepted=f"{_wanted(model)} in the same folder",
            )
    digest = hashlib.sha256(content)
    for name, part in files.items():
        digest.update(f"{name} {len(part)}\n".encode())
        digest.update(part)
    return OpenClipConfig(model, path, False, preprocess, files, digest.hexdigest())


def _content(path: Path) -> bytes | None:
    """What a file holds; None where there is none."""
    try:
        return read_regular(path)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ModelError(f"cannot be read: {error.strerror}", path=path) from error


def _read(path: Path, content: bytes) -> tuple[dict[str, Any], dict[str, Any]]:
    """The model's and the preprocessing's part of a configuration."""
    try:
        value = parse_json(content)
    except ValueError as error:
        raise ModelError(f"not JSON: {error}", path=path, accepted=_FORMAT) from error
    preprocess: Any = {}
    if isinstance(value, dict) and "model_cfg" in value:
        value, preprocess = value["model_cfg"], value.get("preprocess_cfg", {})
    if not isinstance(value, dict) or not isinstance(preprocess, dict):
        raise ModelError("no JSON object", path=path, accepted=_FORMAT)
    dim = value.get("embed_dim")
    if not isinstance(dim, int) or dim < 1:
        raise ModelError(f"embed_dim is {dim!r}", path=path, accepted="a whole number above 0")
    for key in ("vision_cfg", "text_cfg"):
        if not isinstance(value.get(key), dict):
            raise ModelError(f"{key} is no JSON object", path=path, accepted=_FORMAT)
    _check_vision(value["vision_cfg"], path)
    _check_preprocess(preprocess, path)
    return value, preprocess


def _check_vision(vision: Mapping[str, Any], path: Path) -> None:
    size = vision.get("image_size", _DEFAULT_SIZE)
    sides = {size} if isinstance(size, int) else set(size) if isinstance(size, list) else set()
    if len(sides) != 1 or not all(isinstance(side, int) and side > 0 for side in sides):
        raise ModelError(
            f"image_size is {size!r}", path=path, accepted="one whole number: patches are square"
        )
    name = vision.get("timm_model_name")
    if name is not None and not re.fullmatch(r"[\w.\-]+", str(name)):
        # "hf-hub:..." would have timm look it up, "local-dir:..." would read another folder
        raise ModelError(
            f"timm_model_name is {name!r}", path=path, accepted="a model that timm itself brings"
        )


def _check_preprocess(preprocess: Mapping[str, Any], path: Path) -> None:
    for key in ("mean", "std"):
        value = preprocess.get(key)
        values = value if isinstance(value, list) else [value] * 3
        numbers = len(values) == 3 and all(isinstance(v, (int, float)) for v in values)
        if value is not None and not (numbers and (key == "mean" or min(values) > 0)):
            raise ModelError(
                f"{key} is {value!r}", path=path, accepted="a number for each of the 3 channels"
            )
    if preprocess.get("interpolation") not in (None, "bicubic", "bilinear", "random"):
        raise ModelError(
            f"interpolation is {preprocess['interpolation']!r}",
            path=path,
            accepted="bicubic, bilinear",
        )


def _looked_up(model: Mapping[str, Any]) -> str:
    """What open_clip would fetch for the text tower; empty for CLIP's own."""
    text = model["text_cfg"]
    wanted = {"tokenizer": "hf_tokenizer_name", "network": "hf_model_name"}
    return " and ".join(
        f"the {what} {text[key]!r}" for what, key in wanted.items() if text.get(key)
    )


def _wanted(model: Mapping[str, Any]) -> str:
    files = " or ".join(VOCABULARIES)
    return f"{NETWORK_CONFIG} and {files}" if "hf_model_name" in model["text_cfg"] else files
