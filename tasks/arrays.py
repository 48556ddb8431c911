"""Named arrays as .safetensors files whose bytes depend on nothing but their content."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from gvr_core.errors import StoreError
from tasks.records import canonical_json

DTYPES = frozenset(
    np.dtype(code).name
    for code in ("?", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8")
)
"""Names of the dtypes that can be stored."""

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
    prepared = {name: _prepare(name, arrays[name]) for name in sorted(arrays)}
    # One metadata key only: the library writes several in random order.
    save_file(prepared, path, metadata={_META: canonical_json(dict(meta), name="meta").decode()})


def _prepare(name: str, array: NDArray[Any]) -> NDArray[Any]:
    """The array in C order and little-endian: the library copies memory as it lies."""
    if not isinstance(name, str) or not name or name == "__metadata__":
        raise StoreError(f"array name {name!r} (accepted: a non-empty string)")
    if not isinstance(array, np.ndarray) or array.dtype.name not in DTYPES:
        found = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
        raise StoreError(
            f"array {name!r} is of type {found} (accepted: {', '.join(sorted(DTYPES))})"
        )
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    # Not ascontiguousarray: it gives a 0-d array one axis.
    return little if little.flags.c_contiguous else little.copy(order="C")


class StoredArrays(Mapping[str, NDArray[Any]]):
    """The arrays of one file; each is read when it is asked for, and not kept.

    Raises:
        StoreError: The file is not a safetensors file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            opened: Any = safe_open
            self._file: Any = opened(str(path), framework="numpy")
            self._names = sorted(self._file.keys())
        except (SafetensorError, OSError) as error:
            raise StoreError(f"{path}: not a safetensors file: {error}") from error

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._names:
            raise KeyError(name)
        try:
            array: NDArray[Any] = self._file.get_tensor(name)
        except (SafetensorError, OSError, AttributeError, TypeError, ValueError) as error:
            # Of a dtype that numpy does not have, the library's own errors are of these kinds.
            raise StoreError(f"{self._path}: array {name!r} cannot be read: {error}") from error
        return array

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of an array, without reading it."""
        return tuple(self._file.get_slice(name).get_shape())
