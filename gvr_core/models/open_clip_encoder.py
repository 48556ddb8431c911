"""CLIP through open_clip: patches and texts in one space, at full strength."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from gvr_core.errors import ModelError
from gvr_core.models.base import FloatArray, Frame, Mask
from gvr_core.models.checkpoints import Checkpoint
from gvr_core.models.crops import Colour, CropMode, crop_patches
from gvr_core.models.devices import Batches, DeviceChoice, pick_device
from gvr_core.models.open_clip_config import file_config, library_config
from gvr_core.models.open_clip_network import OpenClipNetwork, Precision, load_network
from gvr_core.models.text_memory import TextMemory

if TYPE_CHECKING:
    import torch

BLACK: Colour = (0, 0, 0)

ACTIVATIONS_PER_VALUE = 64
"""Memory of a patch while it is encoded, over that of its picture in float32: an upper bound.
Measured in float32: ViT-B-16 25 (14 MB), ConvNeXt-B 21, RN50x4 with its wide stem 37 (35 MB)."""

_SMALLEST = 1e-12
"""Shorter vectors than this stay as they are; the bound of ``torch.nn.functional.normalize``."""


class OpenClipSettings(BaseModel):
    """How an open_clip model looks at patches, and where its files are."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    checkpoint: Path | None = None
    """A local checkpoint instead of the one in the models folder."""
    config: Path | None = None
    """A JSON configuration in open_clip's format, for a model that the library does not know or
    whose tokenizer it would look up."""
    crops: tuple[CropMode, ...] = Field(default=("masked",), min_length=1)
    """What is shown of a patch; features of several are averaged, and then normalised."""
    fill: Literal["black", "mean"] = "black"
    """What stands outside of the mask and pads to a square: black, as in LangSplat
    (``get_seg_img`` and ``pad_img`` in its preprocess.py), or the mean that the model subtracts,
    which leaves zeros."""
    precision: Literal["auto", "fp32", "fp16", "bf16"] = "auto"
    """``"auto"`` is fp16 on CUDA, as in LangSplat, and fp32 on the processor."""
    batch: int = Field(default=256, ge=1)
    """At most so many patches at once."""


class OpenClipEncoder:
    """Any model of open_clip (Ilharco et al.; Cherti et al. 2023) behind the Encoder protocol.

    A patch is cut out, resized and normalised as the model's own preprocessing does it to a
    square picture. Threads may share an encoder. Weights are loaded when they are first needed.

    Args:
        model_name: The library's name of the architecture, e.g. ``"ViT-B-16"``; any name where
            the settings bring a configuration.
        tag: The library's name of the training, e.g. ``"laion2b_s34b_b88k"``; any for a local
            checkpoint.
        weights: The checkpoint.
        settings: Crops, filling and precision.
        device_choice: Where it computes.

    Raises:
        ModelError: for a model that open_clip does not know, a configuration that is wrong, or
            a text tower that would have to be looked up on the Hugging Face Hub.
    """

    def __init__(
        self,
        model_name: str,
        tag: str,
        weights: Checkpoint,
        settings: OpenClipSettings | None = None,
        device_choice: DeviceChoice = "auto",
    ) -> None:
        self._tag = (model_name, tag)
        self._weights = weights
        self._settings = settings or OpenClipSettings()
        self._device_choice = device_choice
        path = self._settings.config
        self._config = library_config(model_name) if path is None else file_config(path)
        item_bytes = ACTIVATIONS_PER_VALUE * 4 * 3 * self._config.size**2
        self._batches = Batches("patches", item_bytes, self._settings.batch)
        self._texts = TextMemory(self._encode_text, self.dim)
        self._loading = Lock()
        self._loaded: OpenClipNetwork | None = None

    @property
    def name(self) -> str:
        """Name, version, settings, and digests of the weights and of a local configuration."""
        settings, config = self._settings, self._config
        parts = [
            *self._tag,
            f"@{self._weights.tag}",
            *([] if config.own else [f"config@{config.tag}"]),
            f"crops={'+'.join(settings.crops)}",
            f"fill={settings.fill}",
            f"precision={self._precision}",
            f"open_clip_torch={version('open_clip_torch')}",
        ]
        return f"open_clip/1({','.join(parts)})"

    @property
    def dim(self) -> int:
        """c: length of a semantic vector."""
        return self._config.dim

    @cached_property
    def _device(self) -> torch.device:
        return pick_device(self._device_choice)

    @property
    def _precision(self) -> Precision:
        if self._settings.precision != "auto":
            return self._settings.precision
        return "fp16" if self._device.type == "cuda" else "fp32"

    @property
    def _network(self) -> OpenClipNetwork:
        with self._loading:
            if self._loaded is None:
                self._loaded = load_network(
                    self._config, self._tag, self._weights, self._precision, self._device
                )
            return self._loaded

    def encode_patches(self, frame: Frame, masks: Sequence[Mask]) -> FloatArray:
        """Semantic vectors (m, c) float32 of the patches of one frame, each of length 1.

        Args:
            frame: The frame; its colours are rounded to 8 bits, as the model's training had them.
            masks: The m patches; an empty one is encoded as a picture of the filling colour.

        Raises:
            ModelError: if a mask is not of the frame's size; if the weights are missing, unsafe
                or do not fit; if not one patch fits into memory; or if half precision overflows.
            ConfigError: if CUDA is demanded and there is none.
        """
        if not masks:
            return np.empty((0, self.dim), np.float32)
        network = self._network
        fill = BLACK
        if self._settings.fill == "mean":
            red, green, blue = (round(255 * value) for value in network.mean)
            fill = (red, green, blue)

        def encode(part: Sequence[Mask]) -> FloatArray:
            total = np.zeros((len(part), self.dim), np.float32)
            for mode in self._settings.crops:
                pictures = crop_patches(
                    frame.rgb, part, mode, network.size, fill, network.interpolation
                )
                total += network.images(pictures)
            return total / np.float32(len(self._settings.crops))

        return self._unit(np.concatenate(self._batches.run(encode, masks, self._device)))

    def encode_texts(self, texts: Sequence[str]) -> FloatArray:
        """Semantic vectors (t, c) float32 of texts, each of length 1; texts are remembered.

        Texts longer than the model's context are cut, as its tokenizer does it.

        Raises:
            ModelError: if the weights are missing, unsafe or do not fit; or if half precision
                overflows.
            ConfigError: if CUDA is demanded and there is none.
        """
        return self._texts.vectors(texts)

    def _encode_text(self, text: str) -> FloatArray:
        vector: FloatArray = self._unit(self._network.text(text)[None])[0]
        return vector

    def _unit(self, features: FloatArray) -> FloatArray:
        """Rows (m, c) scaled to length 1; rows of zeros stay."""
        if not np.isfinite(features).all():
            raise ModelError(
                f"{self.name} gives vectors that are not finite",
                accepted="precision = 'fp32' or 'bf16', where fp16 overflows; else other weights",
            )
        lengths = np.linalg.norm(features, axis=1, keepdims=True)
        unit: FloatArray = features / np.maximum(lengths, np.float32(_SMALLEST))
        return unit
