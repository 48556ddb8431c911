"""The paper's models by name: which files they are made of, and one of each in a process."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from gvr_core.errors import ModelError
from gvr_core.models.base import Encoder, Segmenter, TextSegmenter
from gvr_core.models.checkpoints import Checkpoint, checkpoint
from gvr_core.models.devices import DeviceChoice
from gvr_core.models.grounded_segmenter import grounded
from gvr_core.models.grounding_dino_config import GroundingDinoSettings
from gvr_core.models.open_clip_encoder import OpenClipEncoder, OpenClipSettings
from gvr_core.models.sam_architecture import VARIANTS
from gvr_core.models.sam_onnx import OnnxSam
from gvr_core.models.sam_prompts import SamSettings, SparseSamSettings
from gvr_core.models.sam_segmenter import SamSegmenter
from gvr_core.models.sam_torch import TorchSam
from gvr_core.untrusted import expanded
from gvr_core.weights.folder import located, models_folder

CHECKPOINT_ENDINGS = (".pth", ".pt", ".safetensors")
"""Of files, which a name may give in place of a published model."""


def sam(which: str, settings: SamSettings, device: DeviceChoice) -> Segmenter:
    """Segment Anything through its own library.

    Args:
        which: ``vit_h``, ``vit_l`` or ``vit_b``, or another name in a manifest of the models
            folder, or a checkpoint's path.
        settings: Of the automatic masks.
        device: Where to compute.

    Raises:
        ConfigError: for a device that is not there.
        ModelError: for a name that no manifest has, or a checkpoint that is missing or has
            another digest than is stated.
    """
    if which.endswith(CHECKPOINT_ENDINGS):
        return _sam(checkpoint(Path(which)), None, settings, device)
    found = located(f"sam:{which}")[0]
    variant = which if which in VARIANTS else None
    return _sam(checkpoint(found.path, found.sha256), variant, settings, device)


@lru_cache(maxsize=2)
def _sam(
    weights: Checkpoint, variant: str | None, settings: SamSettings, device: DeviceChoice
) -> Segmenter:
    return SamSegmenter(TorchSam(weights, variant, device), settings)


def sam_onnx(where: str, settings: SparseSamSettings) -> Segmenter:
    """Any SAM that was exported to a pair of ONNX graphs.

    Args:
        where: A folder; one that is not found from here is looked for in the models folder.
        settings: Of the automatic masks.

    Raises:
        ModelError: for a folder without the two graphs.
    """
    return _sam_onnx(OnnxSam.files(onnx_folder(where)), settings)


def onnx_folder(where: str) -> Path:
    """The folder that a name means: from here, else from the models folder.

    Raises:
        ModelError: where neither is there.
    """
    given = expanded(Path(where))
    places = [given.absolute(), models_folder().absolute() / given]
    for place in places:
        if place.is_dir():
            return place
    raise ModelError(
        f"there is no folder {' or '.join(map(str, dict.fromkeys(places)))}",
        accepted="a folder with encoder.onnx and decoder.onnx, here or under GVR_MODELS",
    )


@lru_cache(maxsize=2)
def _sam_onnx(files: tuple[Checkpoint, Checkpoint], settings: SparseSamSettings) -> Segmenter:
    return SamSegmenter(OnnxSam(*files), settings)


def open_clip(which: str, settings: OpenClipSettings, device: DeviceChoice) -> Encoder:
    """Any model of open_clip.

    Args:
        which: ``MODEL/TAG`` as open_clip lists them.
        settings: Crops, precision, and a local checkpoint in place of the models folder's.
        device: Where to compute.

    Raises:
        ConfigError: for a device that is not there.
        ModelError: for a model that is not known, or a checkpoint that is missing or wrong.
    """
    model, _, tag = which.rpartition("/")
    if settings.checkpoint is not None:
        return _open_clip(model, tag, checkpoint(settings.checkpoint), settings, device)
    found = located(f"open_clip:{which}")[0]
    return _open_clip(model, tag, checkpoint(found.path, found.sha256), settings, device)


@lru_cache(maxsize=2)
def _open_clip(
    model: str, tag: str, weights: Checkpoint, settings: OpenClipSettings, device: DeviceChoice
) -> Encoder:
    return OpenClipEncoder(model, tag, weights, settings, device)


def grounded_sam(
    variant: str, settings: GroundingDinoSettings, device: DeviceChoice, segmenter: Segmenter
) -> TextSegmenter:
    """Grounding DINO, whose boxes prompt a segmenter; its network is loaded once a process.

    Args:
        variant: ``swin_b`` or ``swin_t``.
        settings: Thresholds, and local files in place of the models folder's.
        device: Where to compute.
        segmenter: Turns boxes into masks.

    Raises:
        ConfigError: for a device that is not there.
        ModelError: for files that are missing or wrong.
    """
    return grounded(variant, settings, device, segmenter)
