"""Reading ``.splat`` files: 32 bytes a Gaussian, no header.

The format has no specification; the layout is that of its first writer and viewer
(https://github.com/antimatter15/splat, ``convert.py`` and ``main.js``). Colours have one byte a
channel and no view dependence, opacities one byte, rotations one byte a component.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gvr_core.errors import SplatFormatError
from gvr_core.gaussians import SH_C0, Gaussians
from gvr_core.splat_checks import open_splat, require, unit_quaternions

RECORD = np.dtype(
    [
        ("mean", "<f4", 3),
        ("scale", "<f4", 3),  # linear, not logarithms
        ("rgba", "u1", 4),
        ("quat", "u1", 4),  # wxyz, -1 to 1 as 0 to 255 around 128
    ]
)
"""One Gaussian on disk, little-endian."""

_ACCEPTED = f"records of {RECORD.itemsize} bytes: mean 3 f4, scale 3 f4, RGBA 4 u1, wxyz 4 u1"


def read_dot_splat(path: Path | str) -> Gaussians:
    """The Gaussians of a ``.splat`` file, in the order of the file.

    Args:
        path: The file.

    Returns:
        Gaussians with spherical harmonics of degree 0.

    Raises:
        SplatFormatError: if the file cannot be read, is empty, is no whole number of records,
            or has a record with a number that is not finite, a negative scale or a quaternion
            of length zero.
    """
    path = Path(path)
    with open_splat(path) as (stream, size):
        if size == 0 or size % RECORD.itemsize:
            raise SplatFormatError(
                f"the file is {size} bytes long, {size % RECORD.itemsize} more than a whole"
                " number of records"
                if size
                else "the file is empty",
                path=path,
                accepted=_ACCEPTED,
            )
        # The size was taken once: a file that grows or shrinks meanwhile is caught here.
        content = stream.read(size)
    if len(content) != size:
        raise SplatFormatError(f"only {len(content)} of {size} bytes could be read", path=path)
    records = np.frombuffer(content, RECORD)

    for column, lowest in (("mean", -np.inf), ("scale", 0.0)):
        values = records[column]
        require(
            (np.isfinite(values) & (values >= lowest)).all(axis=1),
            values,
            path=path,
            column=column,
            first_row=0,
            accepted="finite numbers" + (", not negative" if lowest == 0 else ""),
            unit="record",
        )
    quats = unit_quaternions(
        (records["quat"].astype(np.float32) - 128) / 128,
        path=path,
        column="quat",
        first_row=0,
        unit="record",
    )
    channels = records["rgba"].astype(np.float32) / 255
    return Gaussians(
        means=np.ascontiguousarray(records["mean"], dtype=np.float32),
        scales=np.ascontiguousarray(records["scale"], dtype=np.float32),
        quats=quats,
        opacities=np.ascontiguousarray(channels[:, 3]),
        sh=np.ascontiguousarray((channels[:, None, :3] - np.float32(0.5)) / np.float32(SH_C0)),
    )
