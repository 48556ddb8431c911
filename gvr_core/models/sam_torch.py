"""Segment Anything through its own library: ViT-H, L, B, or any checkpoint of its modules."""

from __future__ import annotations

from functools import cached_property
from threading import RLock
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gvr_core.errors import ModelError
from gvr_core.models.checkpoints import Checkpoint, load_state
from gvr_core.models.devices import Batches, DeviceChoice, pick_device
from gvr_core.models.sam_architecture import VARIANTS, SamArchitecture
from gvr_core.models.sam_prompts import Embedding, input_coordinates, input_size

if TYPE_CHECKING:
    import torch


class TorchSam:
    """The networks of a checkpoint, loaded when they are first needed.

    Args:
        weights: The checkpoint.
        variant: Which of the published models it has to be; None for any.
        device: Where to compute.
    """

    def __init__(
        self, weights: Checkpoint, variant: str | None = None, device: DeviceChoice = "auto"
    ) -> None:
        self._weights = weights
        self._variant = variant
        self._device = pick_device(device)
        self._pictures = Batches("pictures", 1, 1)
        self._loading = RLock()

    @property
    def name(self) -> str:
        """Name, version, variant and digest of the weights."""
        return f"sam/1:{self._variant or 'local'}@{self._weights.tag}"

    @property
    def side(self) -> int:
        """Side of the square input, pixels."""
        return int(self._model.image_encoder.img_size)

    @property
    def device(self) -> torch.device:
        """Where it computes."""
        return self._device

    @property
    def _model(self) -> Any:
        with self._loading:
            return self._loaded

    @cached_property
    def _loaded(self) -> Any:
        state = load_state(self._weights)
        path = self._weights.path
        shape = SamArchitecture.of_state(state, path)
        if self._variant and (shape.width, shape.depth) != VARIANTS[self._variant]:
            raise ModelError(
                f"holds an image encoder of width {shape.width} and depth {shape.depth}",
                path=path,
                accepted="{} and {} for {}".format(*VARIANTS[self._variant], self._variant),
            )
        try:
            model = shape.build()
            model.load_state_dict(state)
        except (RuntimeError, AssertionError, ValueError) as error:
            raise ModelError(
                f"does not fit segment_anything's modules: {' '.join(str(error).split())[:300]}",
                path=path,
            ) from error
        return model.to(self._device)

    def embed(self, rgb8: NDArray[np.uint8]) -> Embedding:
        """Run the image encoder on an (H, W, 3) uint8 picture.

        Raises:
            ModelError: for weights that cannot be loaded, or where memory runs out.
        """
        import torch
        from segment_anything.utils.transforms import ResizeLongestSide

        model = self._model
        resized = ResizeLongestSide(self.side).apply_image(rgb8)
        picture = torch.as_tensor(resized, device=self._device).permute(2, 0, 1).contiguous()[None]

        def encode(pictures: torch.Tensor) -> torch.Tensor:
            with torch.inference_mode():
                features: torch.Tensor = model.image_encoder(model.preprocess(pictures))
                return features

        features = self._pictures.run(encode, picture, self._device)[0]
        size = (rgb8.shape[0], rgb8.shape[1])
        return Embedding(features, size, input_size(size, self.side), features.nbytes)

    def decode_points(
        self, embedding: Embedding, points: NDArray[Any], labels: NDArray[np.int64]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Masks for each of b prompts of p points; see :class:`PromptableSam`."""
        import torch

        coords = torch.as_tensor(input_coordinates(points, embedding), device=self._device)
        kinds = torch.as_tensor(labels, dtype=torch.int, device=self._device)
        return self._decode(embedding, (coords, kinds), None)

    def decode_box(
        self, embedding: Embedding, box: NDArray[Any]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """The mask that a box frames; see :class:`PromptableSam`."""
        import torch

        corners = input_coordinates(box.reshape(2, 2), embedding)
        return self._decode(
            embedding, None, torch.as_tensor(corners.reshape(1, 4), device=self._device)
        )

    def _decode(
        self, embedding: Embedding, points: Any, boxes: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        import torch

        model = self._model
        with torch.inference_mode():
            sparse, dense = model.prompt_encoder(points=points, boxes=boxes, masks=None)
            logits, scores = model.mask_decoder(
                image_embeddings=embedding.features,
                image_pe=model.prompt_encoder.get_dense_pe(),
                sparse_prompt_embeddings=sparse,
                dense_prompt_embeddings=dense,
                multimask_output=boxes is None and points[0].shape[1] == 1,
            )
        return logits, scores
