"""JSON texts with values, keys and whole branches exchanged: they parse, and say other things."""

from __future__ import annotations

import json
from copy import deepcopy
from random import Random
from typing import Any

NUMBERS = (
    *(0, -1, 1, 2**31, 2**63, 2**64, -(2**63), 10**400, 1e308, -1e308, 5e-324, 1e-40, 0.5),
    *(float("nan"), float("inf"), -float("inf")),
)

TEXTS = (
    *("", " ", ".", "..", "../../etc/passwd", "/etc/passwd", "a/../../b", "C:\\a", "a\\b", "con"),
    *("NUL.png", "a\0b", "a\nb", "\u202etxt.exe", "e\u0301", "\ud800", "x" * 5000, "a" * 255),
    *("~nobody-here/x", "folder:/etc", "9" * 5000, "%2e%2e/", "\u2024\u2024/a"),
)
"""Names and paths that lead astray, among others."""

OTHERS: tuple[Any, ...] = (None, True, False, [], {}, [[]], [None], {"": 0}, [[1, 2]] * 3)


def changed(text: bytes, edits: list[tuple[int, Any, str]]) -> bytes:
    """A text with some places changed.

    Args:
        text: A JSON value, or a value a line.
        edits: For each a number that chooses the place, the new value, and whether it takes
            the place of the value, of the key, or the key goes.
    """
    lines = text.decode().splitlines() if text.count(b"\n{") else [text.decode()]
    content = [json.loads(line) for line in lines if line.strip()]
    for which, value, how in edits:
        places = list(_places(content))
        if not places:
            break
        holder, key = places[which % len(places)]
        value = deepcopy(value)  # else the next edit may put it into itself
        if how == "value" or isinstance(holder, list):
            holder[key] = value
        else:
            old = holder.pop(key)
            if how == "key":
                holder[value if isinstance(value, str) else "x"] = old
    return "\n".join(json.dumps(line) for line in content).encode()


def mutated(text: bytes, seed: int) -> bytes:
    """A text with one to three places changed at random, some for a part of the text itself.

    Raises:
        ValueError: if it is no JSON.
    """
    random = Random(seed)
    own = [holder[key] for holder, key in _places([json.loads(text.split(b"\n{")[0])])]
    edits = []
    for _ in range(random.randint(1, 3)):
        pool = random.choice((NUMBERS, TEXTS, OTHERS, own or OTHERS))
        edits.append(
            (random.getrandbits(30), random.choice(pool), random.choice(("value", "key", "gone")))
        )
    return changed(text, edits)


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Every place in a JSON value: what holds it, and its key or index."""
    found: list[tuple[Any, Any]] = []
    todo = [value]
    while todo:
        item = todo.pop()
        keys = list(item) if isinstance(item, dict) else range(len(item))
        for key in keys:
            found.append((item, key))
            if isinstance(item[key], (dict, list)):
                todo.append(item[key])
    return found
