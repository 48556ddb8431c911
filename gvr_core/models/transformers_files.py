"""Files of a network of ``transformers`` in a local folder, by the names that it gives them."""

from __future__ import annotations

NETWORK_CONFIG = "config.json"
"""Sizes of the network."""

VOCABULARIES = ("tokenizer.json", "vocab.txt")
"""Files that hold a tokenizer's vocabulary; one is enough, and the first goes before the second."""

TOKENIZER_OPTIONS = ("tokenizer_config.json", "special_tokens_map.json", "added_tokens.json")
"""Files that change how texts are cut into tokens, where they are there."""
