"""Files of arrays: written piece by piece as the library writes them whole, read by memory map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from safetensors.numpy import save_file

from gvr_core.books import PatchBook
from gvr_core.errors import StoreError
from gvr_core.models.base import Mask
from tasks.arrays import DTYPES, ArrayWriter, StoredArrays, write_arrays
from tasks.records import canonical_json
from tasks.store import Store

names = st.text(min_size=1, max_size=8).filter(lambda name: name != "__metadata__")
some_arrays = st.dictionaries(
    names,
    st.sampled_from(sorted(DTYPES)).flatmap(
        lambda name: hnp.arrays(name, hnp.array_shapes(min_dims=0, min_side=0, max_side=5))
    ),
    max_size=6,
)


def library_file(path: Path, arrays: dict[str, Any], meta: dict[str, Any]) -> bytes:
    """The twin: what the library writes for arrays that are in memory whole."""
    save_file(arrays, path, metadata={"gvr": canonical_json(meta).decode()})
    return path.read_bytes()


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(some_arrays, st.dictionaries(names, st.integers() | names, max_size=3))
def test_a_file_is_the_library_s_bit_for_bit(tmp_path_factory, arrays, meta) -> None:
    folder = tmp_path_factory.mktemp("arrays")
    write_arrays(folder / "ours", arrays, meta)
    assert (folder / "ours").read_bytes() == library_file(folder / "twin", arrays, meta)
    back = StoredArrays(folder / "ours")
    assert list(back) == sorted(arrays) and len(back) == len(arrays)
    for name, array in arrays.items():
        assert back[name].dtype == array.dtype and back.shape(name) == array.shape
        np.testing.assert_array_equal(back[name], array)
        assert back[name].ctypes.data % array.dtype.itemsize == 0


def test_pieces_in_any_order_make_the_same_file(tmp_path: Path) -> None:
    whole = {
        "values": np.arange(60, dtype=np.uint8).reshape(20, 3),
        "depth": np.linspace(0, 1, 20, dtype=np.float32),
        "sizes": np.array([[4, 5]], np.int32),
    }
    layout = {name: (array.dtype, array.shape) for name, array in whole.items()}
    with ArrayWriter(tmp_path / "pieces", layout, {"n": 1}) as writer:
        writer.append("depth", whole["depth"][:7])
        writer.append("values", whole["values"][:11])
        writer.append("depth", whole["depth"][7:].astype(">f4"))
        writer.append("sizes", np.asfortranarray(whole["sizes"]))
        writer.append("values", whole["values"][11:].ravel())
    assert (tmp_path / "pieces").read_bytes() == library_file(tmp_path / "twin", whole, {"n": 1})


@pytest.mark.parametrize(
    ("pieces", "message"),
    [
        ([np.zeros(3, np.float32)], "lacks its last 2 values"),
        ([np.zeros(3, np.float32)] * 2, "more values"),
        ([np.zeros(5, np.float64)], "gets float64"),
    ],
)
def test_pieces_that_do_not_fit_leave_nothing_in_the_store(tmp_path, pieces, message) -> None:
    store = Store(tmp_path)
    with (
        pytest.raises(StoreError, match=message),
        store.new_arrays("test", {"a": ("f4", (5,))}) as new,
    ):
        for piece in pieces:
            new.append("a", piece)
    with pytest.raises(StoreError, match="still being written"):
        _ = new.artifact
    assert not list(store.temporary.iterdir()) and not (store.root / "objects").exists()


def test_new_arrays_are_those_of_put_arrays(tmp_path: Path) -> None:
    store, values = Store(tmp_path), np.arange(10, dtype=np.int64)
    with store.new_arrays("test", {"a": ("i8", (10,))}, {"k": 1}) as new:
        new.append("a", values[:4])
        new.append("a", values[4:])
    assert new.artifact == store.put_arrays("test", {"a": values}, {"k": 1})


def test_mapped_arrays_are_read_only_and_outlive_letting_go_of_their_pages(tmp_path) -> None:
    values = np.arange(100_000, dtype=np.float32)
    write_arrays(tmp_path / "a", {"values": values}, {})
    stored = StoredArrays(tmp_path / "a")
    mapped = stored["values"]
    with pytest.raises(ValueError, match="read-only"):
        mapped[0] = 1
    stored.let_go()
    np.testing.assert_array_equal(mapped, values)
    del stored
    assert mapped[-1] == 99_999
    with pytest.raises(KeyError):
        StoredArrays(tmp_path / "a")["other"]


@pytest.mark.parametrize("content", [b"", b"\x05", b"\xff" * 40, b"\x02" + bytes(7) + b"{}x"])
def test_what_is_no_file_of_arrays_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.safetensors"
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"bad\.safetensors: not a safetensors file"):
        StoredArrays(path)


def test_a_large_semantic_vector_book_stays_small(tmp_path) -> None:
    """300 views of 988x731 with 100 patches each, c = 512: under 64 MB."""
    rng, views, per_view = np.random.default_rng(0), 300, 100
    rows, columns = np.mgrid[0:731, 0:988]
    few = []
    for _ in range(24):  # wavy discs, as large as things are in pictures
        x, y, radius = rng.uniform(0, 988), rng.uniform(0, 731), rng.uniform(15, 120)
        angle = np.arctan2(rows - y, columns - x)
        edge = radius * (1 + 0.15 * np.sin(rng.integers(3, 12) * angle))
        few.append(Mask(np.hypot(rows - y, columns - x) <= edge))
    drawn = PatchBook.of_masks([few], [(731, 988)])
    bytes_each = len(drawn.rle) / len(drawn)
    vectors = np.zeros((views * per_view, 512), np.float16)
    rle = np.zeros(int(bytes_each * views * per_view), np.uint8)
    write_arrays(tmp_path / "book", {"features": vectors, "rle": rle}, {})
    assert (tmp_path / "book").stat().st_size < 64e6
    assert StoredArrays(tmp_path / "book")["features"].shape == (30_000, 512)
