"""Small files that promise a lot, by target: each asks for memory or time it has no right to.

Those that a fuzzer found lie in ``tests/data/hostile``, named ``<target>--<what>.bin``.
"""

from __future__ import annotations

import io
import json
import pickle
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np

FOUND = Path(__file__).resolve().parent / "data" / "hostile"
HUGE = 2**40


def ply(count: int, form: str = "binary_little_endian", before: str = "") -> bytes:
    """The header of a splat of so many Gaussians, and one row of zeros."""
    names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
    columns = "".join(f"property float {name}\n" for name in names.split())
    head = f"ply\nformat {form} 1.0\n{before}element vertex {count}\n{columns}end_header\n"
    return head.encode() + bytes(14 * 4)


def png(width: int, height: int, *, body: bytes = b"") -> bytes:
    """A grey PNG of that size by its header, its pixels packed a thousand to a byte."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content))
            + kind
            + content
            + struct.pack(">I", zlib.crc32(kind + content))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"".join(
        (
            b"\x89PNG\r\n\x1a\n",
            chunk(b"IHDR", head),
            body and chunk(b"zTXt", b"a\0\0" + zlib.compress(body, 9)),
            chunk(b"IDAT", zlib.compress(bytes(10**6), 9)),
            chunk(b"IEND", b""),
        )
    )


def npy(header: str) -> bytes:
    """An array by its header, and eight bytes of it."""
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x02\x00" + struct.pack("<I", len(text)) + text + bytes(8)


def packed_checkpoint() -> bytes:
    """A checkpoint whose tensor of 256 MB is packed into 250 KB."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("archive/data.pkl", pickle.dumps({}, 2))
        archive.writestr("archive/data/0", bytes(2**28))
        archive.writestr("archive/version", b"3\n")
    return file.getvalue()


def nested(depth: int) -> bytes:
    return b"[" * depth + b"]" * depth


def crafted() -> dict[str, tuple[str, bytes]]:
    """What it is -> the target, and the file."""
    shape = "{'descr': '<f4', 'fortran_order': False, 'shape': (%s,), }"
    tensor = json.dumps({"a": {"dtype": "F32", "shape": [HUGE], "data_offsets": [0, 4 * HUGE]}})
    text = tensor.encode()
    lying_tensor = struct.pack("<Q", len(text)) + text
    size = struct.pack("<Q", HUGE)
    label = {"info": {"name": "frame_00001.jpg", "width": 8888, "height": 8888}}
    corner = [[-9, -9], [9999, -9], [9999, 9999], [-9, 9999]]
    thing = {"category": "a", "segmentation": corner}
    files = {
        "ply of 2^40 vertices": ("ply", ply(HUGE)),
        "ply of 2^40 vertices in text": ("ply", ply(HUGE, "ascii")),
        "ply of 2^40 rows without columns": ("ply", ply(1, "ascii", f"element a {HUGE}\n")),
        "ply with a header of 200 KB": (
            "ply", ply(1, before="element a 0\n" + "".join(
                f"property float p{i}\n" for i in range(9000))),
        ),
        "2^40 cameras": ("colmap-cameras-bin", size + bytes(100)),
        "2^40 images": ("colmap-images-bin", size + bytes(100)),
        "2^40 points": ("colmap-points3D-bin", size + bytes(100)),
        "an image of 2^40 points": (
            "colmap-images-bin",
            struct.pack("<QI7dI", 1, 1, 1, 0, 0, 0, 0, 0, 4, 1) + b"a.png\0" + size,
        ),
        "a point seen 2^40 times": (
            "colmap-points3D-bin", struct.pack("<QQ3d3Bd", 1, 1, 0, 0, 1, 1, 2, 3, 0.5) + size,
        ),
        "a png of 60000 x 60000": ("picture", png(60_000, 60_000)),
        "a png of 2^31 x 1": ("picture", png(2**31 - 1, 1)),
        "a png with a text of 200 MB": ("picture", png(10, 10, body=bytes(200 * 2**20))),
        "a predicted mask of 30000 x 30000": ("predictions-png", png(30_000, 30_000)),
        "labels of 2^40 Gaussians": ("labels-npy", npy(shape % HUGE)),
        "flags of 2^40 Gaussians": ("predictions-flags", npy(shape % HUGE)),
        "maps of 2^20 x 2^20": ("predictions-maps", npy(shape % f"{2**20}, {2**20}")),
        "a tensor of 2^40 numbers": ("safetensors", lying_tensor),
        "a stored array of 2^40 numbers": ("stored-arrays", lying_tensor),
        "a header of 2^40 bytes": ("safetensors", size + text),
        "a bytearray of 2^40": (
            "torch-pickle", b"\x80\x02cbuiltins\nbytearray\n\x8a\x06\x00\x00\x00\x00\x00\x01\x85R.",
        ),
        "a bytearray of 2^30": (
            "torch-file", b"\x80\x02cbuiltins\nbytearray\n\x8a\x04\x00\x00\x00\x40\x85R.",
        ),
        "a tuple of 2^60 parts": (
            "torch-pickle", b"\x80\x02}q\x00K\x01" + b"q\x01h\x01\x86" * 60 + b"K\x01s.",
        ),
        "a checkpoint packed a thousand times": ("torch-file", packed_checkpoint()),
        "500 objects of 79 million pixels": (
            "lerf-labels", json.dumps(label | {"objects": [thing] * 500}).encode(),
        ),
        "a key of 16,000 parts": ("suite", b"a." * 16_000 + b"a=1"),
        "a manifest of 16,000 parts": ("manifest", b"a." * 16_000 + b"a=1"),
        "flags for 2^40 Gaussians in the store": ("stored-arrays", _answers()),
        **{
            f"{name} nested {depth} deep": (name, nested(depth))
            for name in ("cameras-json", "transforms-json", "lerf-labels", "scene-json",
                         "queries-json", "open-clip-config", "bert-config", "stage-record",
                         "prefect-result", "result-result.json", "result-rows.jsonl")
            for depth in (990, 100_000)
        },
    }  # fmt: skip
    for path in sorted(FOUND.glob("*.bin")):
        files[path.stem] = (path.stem.partition("--")[0], path.read_bytes())
    return files


def _answers() -> bytes:
    """Answers whose flags are to be unpacked to a length of their choosing."""
    from safetensors.numpy import save

    return save(
        {
            "n": np.array([2**33]),
            "flags": np.zeros((1, 1), np.uint8),
            "found": np.ones(1, bool),
            "confidence": np.ones(1),
            "locations": np.zeros((1, 3)),
        }
    )
