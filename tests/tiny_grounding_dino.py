"""A small Grounding DINO with random weights: checkpoint, configuration and BERT made on the spot.

It is built by the library's own constructor, from the library's own configuration file. Only the
backbone keeps its published size, as the library knows no smaller one than Swin-T.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from gvr_core.models.grounding_dino_config import MEMORY_TRICKS, GroundingDinoSettings

WORDS = ("a", "the", "cup", "red", "cat", "spoon", "photo", "of", "##s")

SMALL = {"enc_layers": 1, "dec_layers": 2, "dim_feedforward": 64, "num_queries": 20}

SIDE = 96
"""Shorter side of the pictures that it is asked with, pixels."""


@dataclass(frozen=True)
class TinyGroundingDino:
    """The files of a small Grounding DINO, all of them local."""

    checkpoint: Path
    """``{"model": state}``, half precision, with BERT's weights, as the published ones."""
    config: Path
    """All of the library's keys as JSON, which the library's own loader reads as well."""
    bert: Path
    """BERT's configuration and tokenizer, without weights."""
    bert_with_weights: Path
    """The same with a file of (other) weights, which the library's own loader asks for."""

    def settings(self, **changes: Any) -> GroundingDinoSettings:
        """Settings that lead to these files; any threshold is passed unless told otherwise."""
        values: dict[str, Any] = {
            "checkpoint": self.checkpoint,
            "config": self.config,
            "bert": self.bert,
            "box_threshold": 0.0,
            "text_threshold": 0.0,
            "shorter_side": SIDE,
            "longest_side": 2 * SIDE,
        }
        return GroundingDinoSettings(**(values | changes))


def write_tiny_grounding_dino(
    folder: Path, words: Sequence[str] = WORDS, seed: int = 0
) -> TinyGroundingDino:
    """Make the files of a small Grounding DINO.

    Args:
        folder: Where to; it is made.
        words: What the tokenizer knows besides its marks; letters are added.
        seed: Of the weights.
    """
    from groundingdino.models import build_model
    from groundingdino.util.slconfig import SLConfig

    from gvr_core.models.checkpoints import installed_file

    folder.mkdir(parents=True, exist_ok=True)
    tiny = TinyGroundingDino(
        folder / "tiny.pth", folder / "tiny.json", folder / "bert", folder / "bert_with_weights"
    )
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        bert = _write_bert(tiny.bert, words)
        _write_bert(tiny.bert_with_weights, words)
        bert.save_pretrained(tiny.bert_with_weights)
        own = installed_file("groundingdino", "config/GroundingDINO_SwinT_OGC.py")
        keys = SLConfig.fromfile(str(own))
        keys.update(SMALL | dict.fromkeys(MEMORY_TRICKS, False))
        keys.update(text_encoder_type=str(tiny.bert_with_weights))
        tiny.config.write_text(json.dumps(keys._cfg_dict.to_dict()))
        network = build_model(keys)
        _spread(network)
    state = network.state_dict()
    halved = {k: v.half() if v.is_floating_point() else v for k, v in state.items()}
    torch.save({"model": halved}, tiny.checkpoint)
    return tiny


def _write_bert(folder: Path, words: Sequence[str]) -> Any:
    from transformers import BertConfig, BertModel, BertTokenizerFast

    folder.mkdir()
    letters = [chr(code) for code in range(ord("a"), ord("z") + 1)]
    vocabulary = ["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]", ".", "?", ",", *words]
    vocabulary += [letter for letter in letters if letter not in words]
    vocabulary += [f"##{letter}" for letter in letters if f"##{letter}" not in words]
    (folder / "vocab.txt").write_text("\n".join(vocabulary) + "\n")
    BertTokenizerFast(vocab_file=str(folder / "vocab.txt")).save_pretrained(folder)
    sizes = BertConfig(
        vocab_size=len(vocabulary),
        hidden_size=32,
        num_hidden_layers=2,
        num_attention_heads=2,
        intermediate_size=64,
        max_position_embeddings=256,
    )
    sizes.save_pretrained(folder)
    return BertModel(sizes)


def _spread(network: Any) -> None:
    """Untrained, all probabilities are near 0 or 1 and boxes stay at their first guess."""
    with torch.no_grad():
        network.transformer.decoder.norm.weight.mul_(0.05)
        network.bbox_embed[0].layers[-1].weight.normal_(std=0.05)
        network.bbox_embed[0].layers[-1].bias.normal_(std=0.5)
