"""A SAM at random weights, small enough for tests, from segment_anything's own modules."""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from segment_anything.modeling import (
    ImageEncoderViT,
    MaskDecoder,
    PromptEncoder,
    Sam,
    TwoWayTransformer,
)

from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.models.base import Frame

SIDE, PATCH, CHANNELS = 128, 16, 32


def tiny_sam(seed: int = 0) -> Any:
    """A model whose masks are smooth blobs, predicted to be good."""
    torch.manual_seed(seed)
    grid = SIDE // PATCH
    model = Sam(
        image_encoder=ImageEncoderViT(
            img_size=SIDE,
            patch_size=PATCH,
            embed_dim=48,
            depth=3,
            num_heads=3,
            mlp_ratio=2,
            out_chans=CHANNELS,
            qkv_bias=True,
            norm_layer=partial(torch.nn.LayerNorm, eps=1e-6),
            use_rel_pos=True,
            window_size=3,
            global_attn_indexes=(1,),
        ),
        prompt_encoder=PromptEncoder(
            embed_dim=CHANNELS,
            image_embedding_size=(grid, grid),
            input_image_size=(SIDE, SIDE),
            mask_in_chans=8,
        ),
        mask_decoder=MaskDecoder(
            num_multimask_outputs=3,
            transformer=TwoWayTransformer(depth=2, embedding_dim=CHANNELS, mlp_dim=64, num_heads=8),
            transformer_dim=CHANNELS,
            iou_head_depth=3,
            iou_head_hidden_dim=24,
        ),
        pixel_mean=[123.675, 116.28, 103.53],
        pixel_std=[58.395, 57.12, 57.375],
    ).eval()
    with torch.no_grad():
        # Random networks think nothing of their masks; these think well of all of them, each a
        # little differently, and have logits far from the threshold.
        model.mask_decoder.iou_prediction_head.layers[-1].bias += 0.85
        for network in model.mask_decoder.output_hypernetworks_mlps:
            network.layers[-1].weight *= 60
            network.layers[-1].bias *= 60
    return model


def save_tiny_sam(path: Path, seed: int = 0) -> Path:
    """A checkpoint of it, as the published ones are: a state dict that torch saved."""
    torch.save(tiny_sam(seed).state_dict(), path)
    return path


def export_tiny_sam(folder: Path, chooses: bool, seed: int = 0) -> Path:
    """The same as a pair of ONNX graphs, by segment_anything's own export module.

    Args:
        folder: Where to write ``encoder.onnx`` and ``decoder.onnx``.
        chooses: Whether the decoder gives the best mask only, or all four.
        seed: Of the weights.
    """
    from segment_anything.utils.onnx import SamOnnxModel

    folder.mkdir(parents=True, exist_ok=True)
    model, grid = tiny_sam(seed), SIDE // PATCH
    given = {
        "image_embeddings": torch.randn(1, CHANNELS, grid, grid),
        "point_coords": torch.rand(1, 5, 2) * SIDE,
        "point_labels": torch.ones(1, 5),
        "mask_input": torch.zeros(1, 1, 4 * grid, 4 * grid),
        "has_mask_input": torch.zeros(1),
        "orig_im_size": torch.tensor([100.0, 150.0]),
    }
    with warnings.catch_warnings():  # of the tracing exporter, about itself and the model
        warnings.simplefilter("ignore")
        torch.onnx.export(
            SamOnnxModel(model, return_single_mask=chooses),
            tuple(given.values()),
            str(folder / "decoder.onnx"),
            input_names=list(given),
            output_names=["masks", "iou_predictions", "low_res_masks"],
            dynamic_axes={"point_coords": {1: "points"}, "point_labels": {1: "points"}},
            opset_version=17,
            dynamo=False,
        )
        torch.onnx.export(
            model.image_encoder,
            (torch.zeros(1, 3, SIDE, SIDE),),
            str(folder / "encoder.onnx"),
            input_names=["input"],
            output_names=["output"],
            opset_version=17,
            dynamo=False,
        )
    return folder


def photograph_frame(rgb8: NDArray[np.uint8], depth: float = 0.0) -> Frame:
    """A picture as models see it, with one depth everywhere; 0 is that of a photograph."""
    height, width = rgb8.shape[:2]
    pose = look_at((0, -3, 1), (0, 0, 0), (0, 0, 1))
    camera = Camera(intrinsics(50, width, height), pose, width, height)
    rgb = (rgb8 / np.float32(255)).astype(np.float32)
    return Frame(rgb, np.full((height, width), depth, np.float32), camera)
