"""Ways to spoil a valid file, as hypothesis strategies; and the one thing that must hold."""

from __future__ import annotations

import json
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

from hostile_targets import TARGETS
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from gvr_core.errors import GVRError

quickly = settings(
    max_examples=25,
    deadline=10_000,  # milliseconds: nothing hangs, and no machine is too slow for it
    suppress_health_check=[HealthCheck.too_slow],
    database=None,
)
"""For properties over files; `benchmarks/fuzz.py` goes deeper."""

NUMBERS = st.sampled_from(
    [0, -1, 1, 2**31, 2**63, 2**64, -(2**63), 10**400, 1e308, -1e308, 5e-324, 1e-40, 0.5]
) | st.floats(allow_nan=True, allow_infinity=True)

TEXTS = (
    st.sampled_from(
        [
            "", " ", ".", "..", "../../etc/passwd", "/etc/passwd", "a/../../b", "C:\\a", "a\\b",
            "con", "NUL.png", "a\0b", "a\nb", "\u202etxt.exe", "e\u0301", "\ud800", "x" * 5000,
            "~nobody-here/x", "folder:/etc", "9" * 5000, "%2e%2e/", "a" * 255, "\u2024\u2024/a",
        ]
    )
    | st.text(max_size=20)
)  # fmt: skip
"""Names and paths that lead astray, among others."""

HOSTILE = (
    st.none()
    | st.booleans()
    | NUMBERS
    | TEXTS
    | st.just([])
    | st.just({})
    | st.integers(1, 300).map(lambda depth: json.loads("[" * depth + "]" * depth))
)
"""JSON values that a schema did not expect."""


def read(name: str, data: bytes) -> bool:
    """Whether a target accepts bytes; an error that is no ``GVRError`` fails the test."""
    try:
        TARGETS[name].read(data, _folder(name))
    except GVRError as error:
        assert str(error)
        return False
    return True


@lru_cache(maxsize=len(TARGETS))
def _folder(name: str) -> Path:
    folder = Path(tempfile.mkdtemp(prefix=f"hostile-{name}-"))
    (folder / "run").mkdir()
    return folder / "run"


@lru_cache(maxsize=len(TARGETS))
def seeds(name: str) -> tuple[bytes, ...]:
    """Valid files of a target."""
    folder = _folder(name).with_name("seeds")
    folder.mkdir()
    return tuple(TARGETS[name].seeds(folder))


def damaged(name: str) -> st.SearchStrategy[bytes]:
    """A valid file with bytes cut out, put in or changed, in one to three places."""
    words = [word.encode() for word in TARGETS[name].words] or [b"\xff" * 8]
    piece = st.binary(max_size=12) | st.sampled_from([*words, b"\xff" * 8, b"\0" * 8])
    edit = st.tuples(st.floats(0, 1), st.integers(0, 16), piece)
    return st.builds(_edited, st.sampled_from(seeds(name)), st.lists(edit, min_size=1, max_size=3))


def _edited(seed: bytes, edits: list[tuple[float, int, bytes]]) -> bytes:
    for where, gone, piece in edits:
        at = int(where * len(seed))
        seed = seed[:at] + piece + seed[at + gone :]
    return seed


def misled(name: str) -> st.SearchStrategy[bytes]:
    """A valid JSON file with one to three values exchanged for others, or keys for other names."""
    edit = st.tuples(st.integers(0, 2**30), HOSTILE, st.sampled_from(["value", "key", "gone"]))
    return st.builds(_changed, st.sampled_from(seeds(name)), st.lists(edit, min_size=1, max_size=3))


def _changed(seed: bytes, edits: list[tuple[int, Any, str]]) -> bytes:
    lines = seed.decode().splitlines() if seed.count(b"\n{") else [seed.decode()]
    content = [json.loads(line) for line in lines if line.strip()]
    for which, value, how in edits:
        places = list(_places(content))
        holder, key = places[which % len(places)]
        if how == "value" or isinstance(holder, list):
            holder[key] = value
        else:
            old = holder.pop(key)
            if how == "key":
                holder[value if isinstance(value, str) else "x"] = old
    return "\n".join(json.dumps(line) for line in content).encode()


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
