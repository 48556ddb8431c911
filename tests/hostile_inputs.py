"""Ways to spoil a valid file, as hypothesis strategies; and the one thing that must hold."""

from __future__ import annotations

import atexit
import json
import shutil
import tempfile
from functools import lru_cache
from pathlib import Path

import hostile_json
from hostile_targets import TARGETS
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from gvr_core.errors import GVRError

quickly = settings(
    max_examples=15,
    deadline=10_000,  # milliseconds: nothing hangs, and no machine is too slow for it
    suppress_health_check=[HealthCheck.too_slow],
    database=None,
)
"""For properties over files; `benchmarks/fuzz.py` goes deeper."""

NUMBERS = st.sampled_from(hostile_json.NUMBERS) | st.floats(allow_nan=True, allow_infinity=True)
TEXTS = st.sampled_from(hostile_json.TEXTS) | st.text(max_size=20)

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
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
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
    edits = st.lists(edit, min_size=1, max_size=3)
    return st.builds(hostile_json.changed, st.sampled_from(seeds(name)), edits)
