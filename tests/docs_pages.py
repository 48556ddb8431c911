"""Fenced blocks of the pages in docs, as they stand there."""

from __future__ import annotations

import re
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1] / "docs"
_BLOCK = re.compile(r"^```(\w+)(?: name=(\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(page: str, language: str) -> dict[str, str]:
    """Name -> text of a page's blocks in one language; those without a name are counted from 0."""
    found: dict[str, str] = {}
    for kind, name, text in _BLOCK.findall((DOCS / page).read_text(encoding="utf-8")):
        if kind == language:
            assert name not in found
            found[name or str(len(found))] = text
    return found
