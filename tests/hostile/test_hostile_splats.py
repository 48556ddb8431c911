"""Spoilt splat files: refused with an error of ours, or read."""

from __future__ import annotations

from hostile_inputs import damaged, quickly, read, seeds
from hypothesis import given
from hypothesis import strategies as st


@quickly
@given(st.data())
def test_damaged_ply_files(data: st.DataObject) -> None:
    read("ply", data.draw(damaged("ply")))


@quickly
@given(st.data())
def test_damaged_dot_splat_files(data: st.DataObject) -> None:
    read("splat", data.draw(damaged("splat")))


WORDS = (
    "ply", "format", "ascii", "binary_little_endian", "1.0", "element", "vertex", "face",
    "property", "list", "uchar", "int", "float", "double", "x", "rot_0", "f_rest_0", "comment",
    "obj_info", "end_header", "0", "1", "-1", "99999999999999999", "1e3", "é", "\0", "vertex",
)  # fmt: skip


@quickly
@given(st.lists(st.lists(st.sampled_from(WORDS), max_size=6).map(" ".join), max_size=12))
def test_headers_of_any_words(lines: list[str]) -> None:
    text = "\n".join(["ply", "format ascii 1.0", *lines, "end_header", "0 0 0", ""])
    assert not read("ply", text.encode())


def test_what_is_spoilt_was_good() -> None:
    for name in ("ply", "splat"):
        assert all(read(name, seed) for seed in seeds(name))
