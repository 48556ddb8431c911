"""Arrays in ``.npy`` files that nobody vouches for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MAGIC = b"\x93NUMPY"


def mapped_npy(path: Path) -> NDArray[Any]:
    """The array of a file, mapped: no header can claim more than the file holds, and fill memory.

    Args:
        path: A regular file.

    Returns:
        A read-only array of any shape and of any dtype but objects.

    Raises:
        OSError: if it cannot be read.
        ValueError: if it is no such file: an archive, a pickle, a damaged or a lying header, or
            more behind the array.
    """
    with path.open("rb") as stream:
        # Else an archive would be opened, which is another kind of object.
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise ValueError("this is no .npy file")
    try:
        mapped: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
    except OSError:
        raise
    except Exception as error:  # the header is a Python literal, which fails in many ways
        raise ValueError(f"{type(error).__name__}: {error}"[:200]) from error
    held = path.stat().st_size - mapped.offset  # type: ignore[attr-defined]
    if held != mapped.nbytes:
        raise ValueError(f"{held} bytes follow the header, and the array has {mapped.nbytes}")
    return mapped
