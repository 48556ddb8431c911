"""Named arrays as .safetensors files whose bytes depend on nothing but their content."""

from __future__ import annotations

import json
import math
import mmap
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray
from safetensors import SafetensorError, safe_open

from gvr_core.errors import StoreError
from tasks.records import canonical_json

Layout = Mapping[str, tuple[DTypeLike, tuple[int, ...]]]
"""Name -> dtype and shape of an array that is yet to be written."""

_CODES = {
    "float64": "F64",
    "float32": "F32",
    "float16": "F16",
    "int64": "I64",
    "int32": "I32",
    "int16": "I16",
    "int8": "I8",
    "uint64": "U64",
    "uint32": "U32",
    "uint16": "U16",
    "uint8": "U8",
    "bool": "BOOL",
}
"""dtype -> what a safetensors header calls it."""

DTYPES = frozenset(_CODES)
"""Names of the dtypes that can be stored."""

_ORDER = (
    *("uint64", "int64", "float64", "float32", "uint32", "int32"),
    *("float16", "uint16", "int16", "int8", "uint8", "bool"),
)
"""The library lays arrays out by dtype in this order, then by name: each is then aligned."""

_BY_CODE = {code: np.dtype(name).newbyteorder("<") for name, code in _CODES.items()}

_META = "gvr"


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> None:
    """Write arrays to a new file.

    The file is the same, bit for bit, for the same names, values, dtypes and meta, whatever the
    order of the names, the byte order or the memory layout of the arrays.

    Args:
        path: The file to make.
        arrays: Arrays of any shape, 0-d and empty ones included; see `DTYPES`.
        meta: JSON values, kept in the file's header.

    Raises:
        StoreError: A name or dtype that cannot be stored.
    """
    layout = {name: _layout_of(name, array) for name, array in arrays.items()}
    with ArrayWriter(path, layout, meta) as writer:
        for name, array in arrays.items():
            writer.append(name, array)


def _layout_of(name: str, array: object) -> tuple[np.dtype[Any], tuple[int, ...]]:
    if not isinstance(array, np.ndarray):
        raise _unstorable(name, type(array).__name__)
    return array.dtype, array.shape


def _unstorable(name: str, found: object) -> StoreError:
    return StoreError(f"array {name!r} is of type {found} (accepted: {', '.join(sorted(DTYPES))})")


class ArrayWriter:
    """Writes a file of arrays piece by piece, so that no array needs to be in memory whole.

    What is written is, bit for bit, what ``safetensors.numpy.save_file`` writes for the same
    arrays. Pieces of different arrays may come in any order; those of one array come in its own
    (C) order. A context manager: the file is whole when the block ends.

    Args:
        path: The file to make.
        layout: dtype and shape of every array.
        meta: JSON values, kept in the file's header.

    Raises:
        StoreError: A name or dtype that cannot be stored; and when the block ends, an array that
            has not been written to its end.
    """

    def __init__(self, path: Path, layout: Layout, meta: Mapping[str, Any] | None = None) -> None:
        self._dtypes: dict[str, np.dtype[Any]] = {}
        self._next: dict[str, int] = {}
        self._ends: dict[str, int] = {}
        header, size = self._planned(layout, meta or {})
        for name in self._next:
            self._next[name] += len(header)
            self._ends[name] += len(header)
        self._file = path.open("xb")
        try:
            self._file.write(header)
            self._file.truncate(len(header) + size)
        except BaseException:
            self._file.close()
            raise

    def _planned(self, layout: Layout, meta: Mapping[str, Any]) -> tuple[bytes, int]:
        """The file's header, and how many bytes of arrays follow it; places are set from there."""
        checked = {name: (_checked(name, dtype), shape) for name, (dtype, shape) in layout.items()}
        # One metadata key only: the library writes several in random order.
        entries: dict[str, Any] = {
            "__metadata__": {_META: canonical_json(dict(meta), name="meta").decode()}
        }
        place = 0
        for name in sorted(checked, key=lambda n: (_ORDER.index(checked[n][0].name), n)):
            dtype, shape = checked[name]
            end = place + math.prod(shape) * dtype.itemsize
            entries[name] = {
                "dtype": _CODES[dtype.name],
                "shape": list(shape),
                "data_offsets": [place, end],
            }
            self._dtypes[name] = dtype.newbyteorder("<")
            self._next[name], self._ends[name] = place, end
            place = end
        text = json.dumps(entries, ensure_ascii=False, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 8)
        return len(text).to_bytes(8, "little") + text, place

    def append(self, name: str, values: NDArray[Any]) -> None:
        """Write the next values of an array.

        Args:
            name: The array.
            values: Of its dtype, any shape and memory layout.

        Raises:
            StoreError: Another dtype, or more values than the array has room for.
            OSError: The disk is full.
        """
        dtype = self._dtypes[name]
        if values.dtype.name != dtype.name:
            raise StoreError(f"array {name!r} gets {values.dtype} (accepted: {dtype.name})")
        block = np.ascontiguousarray(values, dtype).reshape(-1).view(np.uint8)
        place = self._next[name]
        if place + len(block) > self._ends[name]:
            raise StoreError(f"array {name!r} gets more values than its shape has")
        self._next[name] = place + len(block)
        self._file.seek(place)
        self._file.write(block.data)

    def __enter__(self) -> ArrayWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()
        if error is None:
            for name, place in self._next.items():
                if place != self._ends[name]:
                    missing = (self._ends[name] - place) // self._dtypes[name].itemsize
                    raise StoreError(f"array {name!r} lacks its last {missing} values")


def _checked(name: str, dtype: DTypeLike) -> np.dtype[Any]:
    if not isinstance(name, str) or not name or name == "__metadata__":
        raise StoreError(f"array name {name!r} (accepted: a non-empty string)")
    found = np.dtype(dtype)
    if found.name not in DTYPES:
        raise _unstorable(name, found)
    return found


class StoredArrays(Mapping[str, NDArray[Any]]):
    """The arrays of one file, read only, by memory map: a page is read when it is touched.

    The system may take pages back whenever it needs the memory. The file must not be cut short
    while it is open here; files of the store are replaced, never changed.

    Raises:
        StoreError: The file is not a safetensors file.
    """

    def __init__(self, path: Path) -> None:
        try:
            opened: Any = safe_open
            with opened(str(path), framework="numpy") as checked:
                names = sorted(checked.keys())
            with path.open("rb") as file:
                length = int.from_bytes(file.read(8), "little")
                header = json.loads(file.read(length))
                self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (SafetensorError, OSError, ValueError) as error:
            raise StoreError(f"{path}: not a safetensors file: {error}") from error
        unknown = [header[name]["dtype"] for name in names if header[name]["dtype"] not in _BY_CODE]
        if unknown:
            raise StoreError(f"{path}: arrays of {unknown[0]} (accepted: {', '.join(_BY_CODE)})")
        self._entries = {name: header[name] for name in names}
        self._start = 8 + length

    def __getitem__(self, name: str) -> NDArray[Any]:
        entry = self._entries[name]
        start = self._start + entry["data_offsets"][0]
        return np.ndarray(entry["shape"], _BY_CODE[entry["dtype"]], self._map, start)

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of an array, without reading it."""
        return tuple(self._entries[name]["shape"])

    def let_go(self) -> None:
        """Take the pages read so far out of this process; arrays stay good, and read them again.

        Without it they count as this process's memory until the system wants it back.
        """
        if hasattr(mmap, "MADV_DONTNEED"):
            self._map.madvise(mmap.MADV_DONTNEED)
