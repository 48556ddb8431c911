"""A small open_clip model with random weights, and what the library itself makes of patches."""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import open_clip
import torch
from open_clip.transform import PreprocessCfg, image_transform_v2
from PIL import Image
from safetensors.torch import save_file

from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.models.base import Frame, Mask
from gvr_core.models.checkpoints import checkpoint
from gvr_core.models.open_clip_encoder import OpenClipEncoder, OpenClipSettings

TEXTS = ["a red cup", "", "the cat that sat on a mat, then left " * 20]
"""Short, empty, and longer than the context."""

TINY_MODEL: dict[str, Any] = {
    "embed_dim": 32,
    "vision_cfg": {
        "image_size": 32,
        "layers": 2,
        "width": 64,
        "head_width": 32,
        "patch_size": 8,
    },
    "text_cfg": {
        "context_length": 77,
        "vocab_size": 49408,
        "width": 32,
        "heads": 2,
        "layers": 2,
    },
}
"""ViT and text transformer of the kinds that ViT-B-16 has, with its tokenizer."""


@dataclass(frozen=True)
class TinyOpenClip:
    """The files of one model."""

    config: Path
    """``open_clip_config.json``; its folder is a ``local-dir:`` of the library."""
    safetensors: Path
    """Checkpoint, safetensors."""
    pt: Path
    """The same, by ``torch.save``."""

    def library_model(self) -> tuple[Any, Any, Any]:
        """The library's own model, its ``preprocess_val`` and its tokenizer."""
        model = library_model(f"local-dir:{self.config.parent}")
        return (
            model,
            preprocess_val(model),
            open_clip.get_tokenizer(f"local-dir:{self.config.parent}"),
        )


def library_model(name: str) -> Any:
    """A model by the library, with the weights that a ``local-dir:`` holds, else random ones."""
    level = logging.getLogger().level
    logging.getLogger().setLevel(logging.ERROR)  # that weights are random is meant here
    try:
        return open_clip.create_model(name, pretrained_text=False).eval()
    finally:
        logging.getLogger().setLevel(level)


def preprocess_val(model: Any) -> Any:
    """What the library does to a picture before the model sees it."""
    return image_transform_v2(PreprocessCfg(**model.visual.preprocess_cfg), is_train=False)


def write_tiny_open_clip(
    folder: Path,
    seed: int = 0,
    model: dict[str, Any] | None = None,
    preprocess: dict[str, Any] | None = None,
) -> TinyOpenClip:
    """Write a model with random weights.

    Args:
        folder: An empty folder, made if it is not there.
        seed: Of the weights.
        model: Its configuration; the tiny one where none is given.
        preprocess: What its pictures go through, e.g. ``{"mean": [0.5, 0.5, 0.5]}``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = TinyOpenClip(
        folder / "open_clip_config.json", folder / "tiny.safetensors", folder / "tiny.pt"
    )
    config = {"model_cfg": model or TINY_MODEL, "preprocess_cfg": preprocess or {}}
    files.config.write_text(json.dumps(config))
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        network = library_model(f"local-dir:{folder}")
        for name, tensor in network.named_parameters():
            # The library starts layers so that features of all pictures are nearly the same.
            if name.startswith("visual") and tensor.ndim > 1:
                torch.nn.init.normal_(tensor, std=tensor[0].numel() ** -0.5)
    state = {name: tensor.detach().contiguous() for name, tensor in network.state_dict().items()}
    save_file(state, files.safetensors)
    torch.save(state, files.pt)
    return files


def encoder(files: TinyOpenClip, weights: Path | None = None, **settings: Any) -> OpenClipEncoder:
    """The model behind the protocol, on the processor.

    Args:
        files: Its configuration and checkpoint.
        weights: Another checkpoint.
        settings: Fields of :class:`OpenClipSettings`.
    """
    chosen = OpenClipSettings(config=files.config, **settings)
    return OpenClipEncoder("tiny", "mine", checkpoint(weights or files.safetensors), chosen, "cpu")


def noise_frame() -> Frame:
    """A frame of noise, 70 x 50 pixels."""
    rgb = np.random.default_rng(3).random((50, 70, 3), dtype=np.float32)
    camera = Camera(intrinsics(55, 70, 50), look_at((0, -3, 1), (0, 0, 0), (0, 0, 1)), 70, 50)
    return Frame(rgb, np.ones((50, 70), np.float32), camera)


def five_masks() -> list[Mask]:
    """Masks for that frame: wide, high, at the edge, with a hole, of one pixel."""
    boxes = [(5, 8, 60, 20), (10, 2, 17, 44), (50, 30, 70, 50), (20, 15, 45, 40), (33, 21, 34, 22)]
    found = []
    for x0, y0, x1, y1 in boxes:
        pixels = np.zeros((50, 70), np.bool_)
        pixels[y0:y1, x0:x1] = True
        found.append(Mask(pixels))
    found[3].pixels[20:30, 25:35] = False
    return found


def unit(rows: torch.Tensor) -> np.ndarray:
    return torch.nn.functional.normalize(rows, dim=-1).numpy()


def shown(frame: Frame, mask: Mask, mode: str, fill: tuple[int, int, int]) -> Image.Image:
    """What a patch is shown as, made with Pillow's own tools."""
    picture = Image.fromarray(np.rint(frame.rgb * 255).astype(np.uint8))
    if mode == "masked":
        inside = Image.fromarray(mask.pixels.astype(np.uint8) * 255)
        picture = Image.composite(picture, Image.new("RGB", picture.size, fill), inside)
    x0, y0, x1, y1 = mask.box
    if mode == "context":
        more_x, more_y = round((x1 - x0) / 4), round((y1 - y0) / 4)
        x0, y0 = max(0, x0 - more_x), max(0, y0 - more_y)
        x1, y1 = min(picture.width, x1 + more_x), min(picture.height, y1 + more_y)
    side = max(x1 - x0, y1 - y0)
    square = Image.new("RGB", (side, side), fill)
    corner = ((side - (x1 - x0)) // 2, (side - (y1 - y0)) // 2)
    square.paste(picture.crop((x0, y0, x1, y1)), corner)
    return square


def library_patches(
    files: TinyOpenClip,
    frame: Frame,
    masks: list[Mask],
    mode: str,
    fill: tuple[int, int, int] = (0, 0, 0),
) -> torch.Tensor:
    """Features of patches by the library alone, not normalised."""
    model, preprocess, _ = files.library_model()
    with torch.inference_mode():
        batch = torch.stack([preprocess(shown(frame, mask, mode, fill)) for mask in masks])
        return model.encode_image(batch, normalize=False)
