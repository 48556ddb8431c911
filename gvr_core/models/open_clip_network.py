"""An open_clip model with its weights in it, built without any look-up on a network."""

from __future__ import annotations

import json
import logging
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from gvr_core.errors import ModelError, some_of
from gvr_core.models.base import FloatArray
from gvr_core.models.checkpoints import Checkpoint, load_state
from gvr_core.models.cpu_workers import cpu_workers
from gvr_core.models.crops import Interpolation
from gvr_core.models.open_clip_config import OpenClipConfig

if TYPE_CHECKING:
    import torch

Precision = Literal["fp32", "fp16", "bf16"]
"""Numbers that the network computes with."""

_CPU_BATCH = 4
"""Pictures that one thread of a processor takes at once."""

_NO_FEATURES = ("logit_scale", "logit_bias")
"""Tensors that only scale similarities; their shapes differ between versions of the library."""

_OPENAI_SIZES = ("input_resolution", "context_length", "vocab_size")
"""Whole numbers that stand among the tensors of OpenAI's checkpoints."""

_POSITION_IDS = "text.transformer.embeddings.position_ids"
"""A counter that older versions of ``transformers`` saved."""


@dataclass(frozen=True, eq=False)
class OpenClipNetwork:
    """Both towers of a CLIP, and what belongs before them. Threads may share it."""

    model: Any
    """``open_clip.CLIP`` or one of its sisters."""
    tokenizer: Any
    """Texts -> (t, length) token numbers."""
    tokenizer_lock: Lock
    """Tokenizers of ``transformers`` must not be used by two threads at once."""
    size: int
    """Side of the pictures, pixels."""
    mean: tuple[float, ...]
    std: tuple[float, ...]
    """What colours in [0, 1] are shifted by and divided by, a channel each."""
    interpolation: Interpolation
    """How the model's pictures were resized in training."""
    dtype: torch.dtype
    device: torch.device

    def images(self, pictures: NDArray[np.uint8]) -> FloatArray:
        """Features of pictures, not normalised.

        Args:
            pictures: (m, size, size, 3) uint8.

        Returns:
            (m, c) float32.
        """
        if self.device.type != "cpu":
            return self._images(pictures)
        # One picture batch a thread: threads that share a batch take half as long again.
        parts = [pictures[i : i + _CPU_BATCH] for i in range(0, len(pictures), _CPU_BATCH)]
        return np.concatenate(list(cpu_workers().map(self._images, parts)))

    def text(self, text: str) -> FloatArray:
        """Features (c,) float32 of one text, not normalised."""
        with self.tokenizer_lock:
            tokens = self.tokenizer([text])
        if self.device.type != "cpu":
            return self._text(tokens)
        return cpu_workers().submit(self._text, tokens).result()

    def _images(self, pictures: NDArray[np.uint8]) -> FloatArray:
        import torch

        with torch.inference_mode():
            # As torchvision's ToTensor and Normalize do it, in their order.
            values = torch.from_numpy(pictures).to(self.device).permute(0, 3, 1, 2).contiguous()
            mean, std = (torch.tensor(v, device=self.device) for v in (self.mean, self.std))
            values = values.to(torch.float32).div_(255)
            values = values.sub_(mean.view(-1, 1, 1)).div_(std.view(-1, 1, 1))
            found = self.model.encode_image(values.to(self.dtype), normalize=False)
            features: FloatArray = found.float().cpu().numpy()
        return features

    def _text(self, tokens: torch.Tensor) -> FloatArray:
        import torch

        with torch.inference_mode():
            found = self.model.encode_text(tokens.to(self.device), normalize=False)
            features: FloatArray = found[0].float().cpu().numpy()
        return features


def load_network(
    config: OpenClipConfig,
    tag: tuple[str, str],
    weights: Checkpoint,
    precision: Precision,
    device: torch.device,
) -> OpenClipNetwork:
    """Build a model and put its weights in.

    Args:
        config: The architecture.
        tag: Names of the model and of its training. Where open_clip lists the pair and the
            architecture is its own, colours, interpolation and activation (QuickGELU) are those
            of that training.
        weights: The checkpoint.
        precision: Numbers that it computes with.
        device: Where.

    Raises:
        ModelError: if the configuration describes no model, or the checkpoint cannot be read
            safely or does not fit.
    """
    import open_clip

    trained: Mapping[str, Any] = open_clip.get_pretrained_cfg(*tag) if config.own else {}
    _refuse_torchscript(weights.path, trained)
    state = load_state(weights)
    with _without_root_log(), TemporaryDirectory() as folder:
        model, tokenizer = _build(config, trained, Path(folder), precision)
    _fill(model, state, weights.path, tag[0])
    model.eval().requires_grad_(False)
    seen = model.visual.preprocess_cfg
    return OpenClipNetwork(
        model.to(device),
        tokenizer,
        Lock(),
        config.size,
        _channels(seen["mean"]),
        _channels(seen["std"]),
        "bilinear" if seen["interpolation"] == "bilinear" else "bicubic",
        open_clip.get_input_dtype(precision) or next(model.parameters()).dtype,
        device,
    )


def _channels(value: float | Iterable[float]) -> tuple[float, ...]:
    """A number for each channel: the library takes one for all."""
    values = (value,) * 3 if isinstance(value, (int, float)) else value
    return tuple(float(v) for v in values)


def _build(
    config: OpenClipConfig, trained: Mapping[str, Any], folder: Path, precision: Precision
) -> tuple[Any, Any]:
    """Model and tokenizer by the library's own factory, from a folder that holds all it needs.

    A folder, not the registry of ``add_model_config``: that is global, and names in it clash.
    """
    import open_clip

    model_cfg = json.loads(json.dumps(config.model))
    for key in ("hf_model_name", "hf_tokenizer_name"):
        if model_cfg["text_cfg"].get(key):
            model_cfg["text_cfg"][key] = str(folder)
    preprocess = {key: trained[key] for key in ("mean", "std", "interpolation") if key in trained}
    described = {"model_cfg": model_cfg, "preprocess_cfg": {**preprocess, **config.preprocess}}
    (folder / "open_clip_config.json").write_text(json.dumps(described))
    for name, content in config.text_files.items():
        (folder / name).write_bytes(content)
    try:
        model = open_clip.create_model(
            f"local-dir:{folder}",
            load_weights=False,
            pretrained_text=False,
            precision=precision,
            force_quick_gelu=bool(trained.get("quick_gelu")),
        )
        return model, open_clip.get_tokenizer(f"local-dir:{folder}")
    except Exception as error:  # a wrong size or key can fail anywhere in the model's making
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ModelError(
            f"no model can be made of it: {type(error).__name__}: {reason}",
            path=config.source,
            accepted="a configuration that open_clip builds",
        ) from error


@contextmanager
def _without_root_log() -> Iterator[None]:
    """Keep from the log that a model is random before its weights are in.

    open_clip logs through the root logger, which would also install a handler there.
    """
    root = logging.getLogger()
    handler = logging.NullHandler()

    def is_other(record: logging.LogRecord) -> bool:
        return Path(record.pathname).parent.name != "open_clip"

    root.addHandler(handler)
    root.addFilter(is_other)
    try:
        yield
    finally:
        root.removeFilter(is_other)
        root.removeHandler(handler)


def _refuse_torchscript(path: Path, trained: Mapping[str, Any]) -> None:
    """TorchScript archives are programs; OpenAI published CLIP as such."""
    if not zipfile.is_zipfile(path):
        return
    with zipfile.ZipFile(path) as archive:
        if not any(name.endswith("/constants.pkl") for name in archive.namelist()):
            return
    place = str(trained.get("hf_hub", "")).strip("/")
    raise ModelError(
        "a TorchScript archive, as OpenAI's .pt files are: it holds a program, not only tensors",
        path=path,
        accepted="the same weights as .safetensors or as a plain state dict"
        + (f"; https://huggingface.co/{place} has open_clip_model.safetensors" if place else ""),
    )


def _fill(model: Any, state: dict[str, torch.Tensor], path: Path, model_name: str) -> None:
    """Put a checkpoint's tensors into a model, after the library's own conversions."""
    accepted = f"a checkpoint of {model_name}"
    try:
        state = _converted(model, state)
    except Exception as error:  # the conversions assume tensors of certain shapes
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ModelError(
            f"does not fit {model_name}: {reason}", path=path, accepted=accepted
        ) from error
    wanted = {k: v for k, v in model.state_dict().items() if k not in _NO_FEATURES}
    wrong = {
        "missing": wanted.keys() - state.keys(),
        "not in the model": state.keys() - wanted.keys(),
        "of another shape": {
            k for k in wanted.keys() & state.keys() if wanted[k].shape != state[k].shape
        },
    }
    if any(wrong.values()):
        parts = [f"{what}: {some_of(sorted(names))}" for what, names in wrong.items() if names]
        raise ModelError(
            f"does not fit {model_name}; {'; '.join(parts)}", path=path, accepted=accepted
        )
    model.load_state_dict(state, strict=False)


def _converted(model: Any, state: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    from open_clip import convert
    from open_clip import model as towers

    state = convert.convert_state_dict(model, state)
    if "positional_embedding" in state and not hasattr(model, "positional_embedding"):
        state = towers.convert_to_custom_text_state_dict(state)
    unused = {*_NO_FEATURES, *_OPENAI_SIZES, _POSITION_IDS} - model.state_dict().keys()
    state = {k: v for k, v in state.items() if k not in unused and k not in _NO_FEATURES}
    towers.resize_pos_embed(state, model)
    towers.resize_text_pos_embed(state, model)
    return state
