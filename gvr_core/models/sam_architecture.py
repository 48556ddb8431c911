"""Which SAM a checkpoint holds, told from the shapes of its tensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gvr_core.errors import ModelError

if TYPE_CHECKING:
    import torch

DECODER_HEADS = 8
"""Attention heads of the mask decoder: the one number that no tensor shows, the same in all."""
MEAN, STD = (123.675, 116.28, 103.53), (58.395, 57.12, 57.375)
"""Normalisation of the input, RGB in 0 to 255; segment_anything.build_sam."""
VARIANTS = {"vit_b": (768, 12), "vit_l": (1024, 24), "vit_h": (1280, 32)}
"""Width and depth of the image encoders that are published."""


@dataclass(frozen=True)
class SamArchitecture:
    """The numbers that segment_anything's modules are made from."""

    width: int
    depth: int
    heads: int
    mlp_ratio: float
    patch: int
    side: int
    """Side of the square input, pixels."""
    window: int
    """Window of local attention, patches; 0 where no block has one."""
    global_blocks: tuple[int, ...]
    channels: int
    """Of the embedding, the prompts and the decoder."""
    mask_channels: int
    decoder_depth: int
    decoder_mlp: int
    iou_depth: int
    iou_width: int
    n_masks: int
    """Masks of an ambiguous prompt."""

    @classmethod
    def of_state(cls, state: Mapping[str, torch.Tensor], path: Path) -> SamArchitecture:
        """Read the numbers off a checkpoint.

        Args:
            state: Name -> tensor.
            path: Where they are from, for errors.

        Raises:
            ModelError: if it is no SAM, naming the tensor that is missing or of another kind.
        """
        try:
            return cls._of_state(_Shapes(state))
        except (KeyError, IndexError, ValueError, ZeroDivisionError) as error:
            raise ModelError(
                f"is no checkpoint of Segment Anything: {error}",
                path=path,
                accepted="tensors named as segment_anything.modeling.Sam names them",
            ) from error

    @classmethod
    def _of_state(cls, shapes: _Shapes) -> SamArchitecture:
        encoder, decoder = "image_encoder", "mask_decoder"
        width, _, patch, _ = shapes[f"{encoder}.patch_embed.proj.weight"]
        _, grid, _, _ = shapes[f"{encoder}.pos_embed"]
        depth = shapes.count(f"{encoder}.blocks")
        tables = [shapes[f"{encoder}.blocks.{i}.attn.rel_pos_h"] for i in range(depth)]
        reach = [(rows + 1) // 2 for rows, _ in tables]
        global_blocks = tuple(i for i, patches in enumerate(reach) if patches == grid)
        local = [patches for patches in reach if patches != grid]
        iou = f"{decoder}.iou_prediction_head.layers"
        return cls(
            width=width,
            depth=depth,
            heads=width // tables[0][1],
            mlp_ratio=shapes[f"{encoder}.blocks.0.mlp.lin1.weight"][0] / width,
            patch=patch,
            side=grid * patch,
            window=local[0] if local else 0,
            global_blocks=global_blocks,
            channels=shapes[f"{encoder}.neck.0.weight"][0],
            mask_channels=shapes["prompt_encoder.mask_downscaling.3.weight"][0],
            decoder_depth=shapes.count(f"{decoder}.transformer.layers"),
            decoder_mlp=shapes[f"{decoder}.transformer.layers.0.mlp.lin1.weight"][0],
            iou_depth=shapes.count(iou),
            iou_width=shapes[f"{iou}.0.weight"][0],
            n_masks=shapes[f"{decoder}.mask_tokens.weight"][0] - 1,
        )

    def build(self) -> Any:
        """The model of segment_anything with these numbers, at random weights, for inference."""
        import torch
        from segment_anything.modeling import (
            ImageEncoderViT,
            MaskDecoder,
            PromptEncoder,
            Sam,
            TwoWayTransformer,
        )

        grid = self.side // self.patch
        return Sam(
            image_encoder=ImageEncoderViT(
                depth=self.depth,
                embed_dim=self.width,
                img_size=self.side,
                mlp_ratio=self.mlp_ratio,
                norm_layer=partial(torch.nn.LayerNorm, eps=1e-6),
                num_heads=self.heads,
                patch_size=self.patch,
                qkv_bias=True,
                use_rel_pos=True,
                global_attn_indexes=self.global_blocks,
                window_size=self.window,
                out_chans=self.channels,
            ),
            prompt_encoder=PromptEncoder(
                embed_dim=self.channels,
                image_embedding_size=(grid, grid),
                input_image_size=(self.side, self.side),
                mask_in_chans=self.mask_channels,
            ),
            mask_decoder=MaskDecoder(
                num_multimask_outputs=self.n_masks,
                transformer=TwoWayTransformer(
                    depth=self.decoder_depth,
                    embedding_dim=self.channels,
                    mlp_dim=self.decoder_mlp,
                    num_heads=DECODER_HEADS,
                ),
                transformer_dim=self.channels,
                iou_head_depth=self.iou_depth,
                iou_head_hidden_dim=self.iou_width,
            ),
            pixel_mean=list(MEAN),
            pixel_std=list(STD),
        ).eval()


class _Shapes:
    """Shapes of a checkpoint's tensors by name."""

    def __init__(self, state: Mapping[str, torch.Tensor]) -> None:
        self._state = state

    def __getitem__(self, name: str) -> tuple[int, ...]:
        if name not in self._state:
            raise KeyError(f"there is no {name}")
        return tuple(self._state[name].shape)

    def count(self, prefix: str) -> int:
        """How many numbered modules follow a prefix."""
        rest = (name[len(prefix) + 1 :] for name in self._state if name.startswith(prefix + "."))
        return len({part.split(".")[0] for part in rest})
