"""Broken splat files of every kind: each gives an error that names file, place and remedy."""

from __future__ import annotations

import io
import struct
import tempfile
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.lib import recfunctions
from plyfile import PlyData, PlyElement
from splat_files import FIELDS, save_vertex, some_gaussians, vertex_of

from gvr_core.errors import GVRError, SplatFormatError
from gvr_core.ply_header import MAX_HEADER_BYTES
from gvr_core.splat_io import read_ply, read_splat, write_ply


@pytest.fixture
def ply(tmp_path: Path) -> Path:
    """A valid binary file of 20 Gaussians of degree 3."""
    path = tmp_path / "valid.ply"
    write_ply(path, some_gaussians())
    return path


def test_unknown_endings(tmp_path: Path):
    for name in ("scene.spz", "scene"):
        with pytest.raises(SplatFormatError, match=r"accepted: \.ply, \.splat"):
            read_splat(tmp_path / name)


@pytest.mark.parametrize("suffix", [".ply", ".splat"])
def test_missing_files_folders_and_empty_files(tmp_path: Path, suffix: str):
    path = tmp_path / f"a{suffix}"
    with pytest.raises(SplatFormatError, match="missing"):
        read_splat(path)
    path.touch()
    with pytest.raises(SplatFormatError, match=r"empty|no PLY file"):
        read_splat(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(SplatFormatError, match="a folder"):
        read_splat(path)
    with pytest.raises(SplatFormatError, match="cannot be read"):
        read_splat(tmp_path / ("x" * 300 + suffix))


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("x", np.nan), ("z", np.inf), ("f_dc_1", -np.inf), ("f_rest_44", np.nan),
        ("opacity", np.nan), ("scale_2", 1000.0), ("scale_0", np.nan), ("scale_1", np.inf),
        ("rot_3", np.inf), ("rot_0", np.nan), ("y", 1e300),
    ],
)  # fmt: skip
def test_bad_numbers_are_named_with_their_place(ply: Path, text: bool, column: str, value: float):
    vertex = vertex_of(ply)
    vertex = vertex.astype([(name, "f8") for name in vertex.dtype.names])
    vertex[column][17] = value
    save_vertex(ply, vertex, text=text)
    with pytest.raises(SplatFormatError) as caught:
        read_ply(ply)
    assert caught.value.path == str(ply)
    assert caught.value.place == f"vertex 17, {column}"
    assert caught.value.accepted


def test_quaternion_of_length_zero(ply: Path):
    vertex = vertex_of(ply)
    for i in range(4):
        vertex[f"rot_{i}"][5] = 0
    with pytest.raises(SplatFormatError, match=r"vertex 5, rot_0\.\.3.*positive length"):
        read_ply(save_vertex(ply, vertex))


@pytest.mark.parametrize("column", ["x", "f_dc_0", "opacity", "scale_1", "rot_2"])
def test_missing_columns(ply: Path, column: str):
    vertex = vertex_of(ply)
    kept = recfunctions.drop_fields(vertex, column)
    with pytest.raises(SplatFormatError, match=f"missing: {column} "):
        read_ply(save_vertex(ply, kept))


@pytest.mark.parametrize("lost", [["f_rest_44"], ["f_rest_0"], [f"f_rest_{i}" for i in range(21)]])
def test_f_rest_columns_that_fit_no_degree(ply: Path, lost: list[str]):
    vertex = vertex_of(ply)
    names = [name for name in vertex.dtype.names if name not in lost]
    table = np.zeros(len(vertex), [(name, "f4") for name in names])
    with pytest.raises(SplatFormatError, match=r"f_rest.*accepted: 0, 9, 24, 45 columns"):
        read_ply(save_vertex(ply, table))


def test_compressed_ply_is_recognised(tmp_path: Path):
    table = np.zeros(3, [("packed_position", "u4"), ("packed_rotation", "u4")])
    with pytest.raises(SplatFormatError, match="compressed PLY"):
        read_ply(save_vertex(tmp_path / "a.ply", table))


HEADER = "ply\nformat {format} 1.0\n{elements}end_header\n"
SPLAT_NAMES = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
SPLAT_COLUMNS = "".join(f"property float {name}\n" for name in SPLAT_NAMES.split())


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize(
    "elements",
    [
        "element vertex 1000000000000\n" + SPLAT_COLUMNS,
        "element vertex 999999999999999999\n" + SPLAT_COLUMNS,
        "element vertex 2\n" + SPLAT_COLUMNS,
        "element other 99999999999\nproperty float a\nelement vertex 1\n" + SPLAT_COLUMNS,
        "element vertex 1\n" + SPLAT_COLUMNS
        + "element face 99999999999\nproperty list uint int vertex_indices\n",
    ],
)  # fmt: skip
def test_headers_that_promise_too_much_allocate_nothing(
    tmp_path: Path, encoding: str, elements: str
):
    path = tmp_path / "liar.ply"
    row = b"0 0 0 0 0 0 0 0 0 0 1 0 0 0\n" if encoding == "ascii" else bytes(14 * 4)
    path.write_bytes(HEADER.format(format=encoding, elements=elements).encode() + row)
    tracemalloc.start()
    try:
        with pytest.raises(SplatFormatError, match="promises"):
            read_ply(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 4 * MAX_HEADER_BYTES


@pytest.mark.parametrize(
    ("elements", "message"),
    [
        ("", "no vertices"),
        ("element face 0\nproperty list uchar int vertex_indices\n", "no vertices, only face"),
        ("element vertex 0\n" + SPLAT_COLUMNS, "no Gaussian"),
        ("element vertex -3\n" + SPLAT_COLUMNS, "'-3' rows"),
        ("element vertex 1e3\n" + SPLAT_COLUMNS, "'1e3' rows"),
        ("element vertex " + "9" * 5000 + "\n" + SPLAT_COLUMNS, "rows"),
        ("element vertex 1\n" + SPLAT_COLUMNS + "property list uchar float extra\n", "a list"),
        ("element e 1\nproperty list uchar float l\nelement vertex 1\n" + SPLAT_COLUMNS, "a list"),
        ("element vertex 1\n" + SPLAT_COLUMNS + "property float x\n", "column x is there twice"),
        ("element vertex 1\nelement vertex 1\n" + SPLAT_COLUMNS, "cannot be read"),
        ("element vertex 1\n", "missing: x, y, z"),
        ("element vertex\n" + SPLAT_COLUMNS, "cannot be read"),
        ("element vertex 1\nproperty half x\n", "cannot be read"),
        ("property float x\n", "cannot be read"),
        ("nonsense\n", "cannot be read"),
    ],
)  # fmt: skip
def test_broken_headers(tmp_path: Path, elements: str, message: str):
    path = tmp_path / "broken.ply"
    header = HEADER.format(format="binary_little_endian", elements=elements)
    path.write_bytes(header.encode() + bytes(200))
    with pytest.raises(SplatFormatError, match=message) as caught:
        read_ply(path)
    assert str(path) in str(caught.value)
    assert caught.value.accepted


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"PK\x03\x04 a zip archive", "no PLY file"),
        (b"plyx\n", "no PLY file"),
        (b"ply\nformat ascii 1.0\n", "no end"),
        (b"ply\n" + b"comment x\n" * 100_000, "no end"),
        (b"ply\nformat ascii 2.0\nend_header\n", "cannot be read"),
        (b"ply\nformat latin 1.0\nend_header\n", "cannot be read"),
        (b"ply\nformat ascii 1.0\ncomment \xff\nend_header\n", "cannot be read"),
        (b"ply\nend_header\n", "cannot be read"),
    ],
)
def test_files_that_are_no_ply(tmp_path: Path, content: bytes, message: str):
    path = tmp_path / "a.ply"
    path.write_bytes(content)
    with pytest.raises(SplatFormatError, match=message):
        read_ply(path)


@pytest.mark.parametrize("text", [False, True])
def test_every_truncation_is_refused(tmp_path: Path, text: bool):
    path = tmp_path / "a.ply"
    write_ply(path, some_gaussians(3, degree=0))
    save_vertex(path, vertex_of(path), text=text)
    content = path.read_bytes()
    # Without the last digits of a text file, its last number is another but the file is whole.
    last = len(content) - len(content.split()[-1]) - 1 if text else len(content)
    for length in range(0, last, 7):
        path.write_bytes(content[:length])
        with pytest.raises(SplatFormatError):
            read_ply(path)


@pytest.mark.parametrize(
    ("line", "place"),
    [
        (b"0 0 0", "vertex 1"),
        (b"0 " * 15, "vertex 1"),
        (b"", "vertex 1"),
        (b"0 0 zero 0 0 0 0 0 0 0 1 0 0 0", "vertex 1, z"),
        (b"0 0 \xc3\xa9 0 0 0 0 0 0 0 1 0 0 0", "vertex 1, z"),
        (b"0 0 0 0 0 0 0 0 0 0 1 0 0 1_0", "vertices from 0"),
    ],
)
def test_bad_lines_of_text(tmp_path: Path, line: bytes, place: str):
    header = HEADER.format(format="ascii", elements="element vertex 3\n" + SPLAT_COLUMNS)
    good = b"0 0 0 0 0 0 0 0 0 0 1 0 0 0\n"
    path = tmp_path / "a.ply"
    path.write_bytes(header.encode() + good + line + b"\n" + good * 3)
    with pytest.raises(SplatFormatError) as caught:
        read_ply(path)
    assert caught.value.place == place


@pytest.mark.parametrize(
    ("at", "value", "place"),
    [
        (4, np.float32(np.nan).tobytes(), "record 1, mean"),
        (12, np.float32(np.inf).tobytes(), "record 1, scale"),
        (20, np.float32(-1).tobytes(), "record 1, scale"),
        (28, bytes([128] * 4), "record 1, quat"),
    ],
)
def test_bad_dot_splat_records(tmp_path: Path, at: int, value: bytes, place: str):
    content = bytearray(struct.pack("<6f8B", 1, 2, 3, 1, 1, 1, 9, 9, 9, 9, 255, 128, 128, 128) * 3)
    path = tmp_path / "a.splat"
    path.write_bytes(content)
    assert len(read_splat(path)) == 3
    content[32 + at : 32 + at + len(value)] = value
    path.write_bytes(content)
    with pytest.raises(SplatFormatError) as caught:
        read_splat(path)
    assert caught.value.place == place


def test_dot_splat_with_part_of_a_record(tmp_path: Path):
    path = tmp_path / "a.splat"
    path.write_bytes(bytes(70))
    with pytest.raises(SplatFormatError, match="70 bytes long, 6 more than"):
        read_splat(path)


def _seeds() -> dict[str, bytes]:
    """Small valid files: PLY as bytes, PLY as text, .splat."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.ply")
        write_ply(path, some_gaussians(4, degree=1))
        binary, text = path.read_bytes(), io.BytesIO()
        PlyData([PlyElement.describe(vertex_of(path), "vertex")], text=True).write(text)
    record = struct.pack("<6f8B", 1, 2, 3, 1, 1, 1, 9, 9, 9, 9, 255, 128, 128, 128)
    return {"a.ply": binary, "text.ply": text.getvalue(), "a.splat": record * 5}


SEEDS = _seeds()


@settings(max_examples=400, deadline=None)
@given(st.sampled_from(sorted(SEEDS)), st.data())
def test_damaged_files_give_a_valid_set_or_an_error_of_ours(name: str, data: st.DataObject):
    content = bytearray(SEEDS[name])
    places = st.integers(0, len(content) - 1)
    for at, byte in data.draw(st.lists(st.tuples(places, st.integers(0, 255)), max_size=6)):
        content[at] = byte
    start, stop = sorted((data.draw(places), data.draw(places)))
    how = data.draw(st.sampled_from(["keep", "cut", "drop", "double"]))
    content = {
        "keep": content,
        "cut": content[:stop],
        "drop": content[:start] + content[stop:],
        "double": content[:stop] + content[start:],
    }[how]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(content)
        try:
            got = read_splat(path)
        except GVRError as error:
            assert str(path) in str(error)
            return
    assert len(got) >= 1
    assert all(np.isfinite(getattr(got, field)).all() for field in FIELDS)
    np.testing.assert_allclose(np.linalg.norm(got.quats, axis=1), 1, atol=1e-6)
    assert ((got.opacities >= 0) & (got.opacities <= 1)).all()
    assert (got.scales >= 0).all()
