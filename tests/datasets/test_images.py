"""Pictures and masks on disk."""

from __future__ import annotations

import io
import struct
import tempfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from datasets.images import MAX_PIXELS, read_image, read_mask, write_png
from gvr_core.errors import DatasetError, GVRError

SHAPES = st.one_of(
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.tuples(st.integers(1, 9), st.integers(1, 9), st.just(3)),
)


@settings(max_examples=60, deadline=None)
@given(SHAPES.flatmap(lambda shape: hnp.arrays(np.uint8, shape)))
def test_pictures_come_back_as_they_were(array: np.ndarray):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.png")
        write_png(path, array)
        got = read_image(path, size=(array.shape[1], array.shape[0]))
        assert [p.name for p in Path(folder).iterdir()] == ["a.png"]
    want = array if array.ndim == 3 else np.repeat(array[:, :, None], 3, axis=2)
    np.testing.assert_array_equal(got, want)
    assert got.dtype == np.uint8
    assert got.flags.writeable


@settings(max_examples=60, deadline=None)
@given(hnp.arrays(np.bool_, st.tuples(st.integers(1, 40), st.integers(1, 40))))
def test_masks_come_back_as_they_were(mask: np.ndarray):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.png")
        write_png(path, mask)
        got = read_mask(path)
        assert Image.open(path).mode == "L"
    np.testing.assert_array_equal(got, mask)
    assert got.dtype == np.bool_


def test_real_photograph(shared: Path):
    path = shared / "data" / "plush" / "images" / "20240212_003919.jpg"
    got = read_image(path, size=(990, 742))
    assert got.shape == (742, 990, 3)
    np.testing.assert_array_equal(got, np.asarray(Image.open(path)))


def test_thresholds_of_masks(tmp_path: Path):
    write_png(tmp_path / "a.png", np.array([[0, 127, 128, 254, 255]], np.uint8))
    assert read_mask(tmp_path / "a.png").tolist() == [[False, False, True, True, True]]
    assert read_mask(tmp_path / "a.png", threshold=128).sum() == 2
    assert read_mask(tmp_path / "a.png", threshold=254).sum() == 1


def test_transparency(tmp_path: Path):
    pixels = np.array([[[255, 255, 255, 255], [255, 255, 255, 0], [200, 100, 50, 128]]], np.uint8)
    path = tmp_path / "a.png"
    Image.fromarray(pixels).save(path)
    assert read_mask(path, threshold=50).tolist() == [[True, False, True]]
    got = read_image(path)
    assert got[0, 0].tolist() == [255, 255, 255]
    assert got[0, 1].tolist() == [0, 0, 0]
    np.testing.assert_allclose(got[0, 2], [100, 50, 25], atol=1)


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGB", "RGBA"])
def test_kinds_of_pixels(tmp_path: Path, mode: str):
    grey = Image.fromarray(np.array([[0, 255, 0], [255, 0, 255]], np.uint8))
    grey.convert(mode).save(tmp_path / "a.png")
    want = np.array([[False, True, False], [True, False, True]])
    np.testing.assert_array_equal(read_mask(tmp_path / "a.png"), want)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png")[:, :, 1] == 255, want)


def test_orientation_tags_are_not_applied(tmp_path: Path):
    exif = Image.Exif()
    exif[0x0112] = 6  # a quarter turn
    Image.new("RGB", (8, 4)).save(tmp_path / "a.jpg", exif=exif)
    assert read_image(tmp_path / "a.jpg", size=(8, 4)).shape == (4, 8, 3)


@pytest.mark.parametrize("read", [read_image, read_mask])
def test_files_that_cannot_be_used(tmp_path: Path, read):
    path = tmp_path / "a.png"
    with pytest.raises(DatasetError, match="no such file"):
        read(path)
    with pytest.raises(DatasetError, match="folder"):
        read(tmp_path)
    path.write_bytes(b"")
    with pytest.raises(DatasetError, match="cannot be decoded"):
        read(path)
    path.write_text("%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n")
    with pytest.raises(DatasetError, match=r"cannot be decoded.*accepted: .*PNG"):
        read(path)
    write_png(path, np.zeros((4, 5), np.uint8))
    with pytest.raises(DatasetError, match=r"5 x 4 pixels.*accepted: 4 x 5"):
        read(path, size=(4, 5))
    Image.fromarray(np.zeros((4, 5), np.uint16)).save(path)
    with pytest.raises(DatasetError, match=r"mode I;16.*accepted: 8 bits a channel"):
        read(path)
    path.write_bytes(png(5, 4, b"\0" * 6 * 4)[:-30])
    with pytest.raises(DatasetError, match="cannot be decoded"):
        read(path)


def png(width: int, height: int, rows: bytes) -> bytes:
    """A grey PNG of any size in its header, whatever rows follow."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        check = struct.pack(">I", zlib.crc32(kind + content))
        return struct.pack(">I", len(content)) + kind + content + check

    header = struct.pack(">2I5B", width, height, 8, 0, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


@pytest.mark.parametrize("side", [9_000, 60_000])
def test_decompression_bombs(tmp_path: Path, side: int):
    assert side**2 > MAX_PIXELS
    path = tmp_path / "bomb.png"
    path.write_bytes(png(side, side, bytes(1000)))
    with pytest.raises(DatasetError, match=r"80000000 pixels|decompression bomb"):
        read_image(path)


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((4, 4), np.float32),
        np.zeros((4, 4, 4), np.uint8),
        np.zeros((4, 4, 3), bool),
        np.zeros(4, np.uint8),
        np.zeros((0, 4), np.uint8),
        np.zeros((4, 4), np.int64),
    ],
)
def test_arrays_that_are_no_picture(tmp_path: Path, array: np.ndarray):
    with pytest.raises(DatasetError, match=r"accepted: \(H, W, 3\) uint8"):
        write_png(tmp_path / "a.png", array)
    assert list(tmp_path.iterdir()) == []


def _seeds() -> dict[str, bytes]:
    rng = np.random.default_rng(0)
    picture = Image.fromarray(rng.integers(0, 256, (12, 9, 3), dtype=np.uint8))
    content = {}
    for kind in ("PNG", "JPEG", "WEBP", "TIFF", "BMP"):
        stream = io.BytesIO()
        picture.save(stream, format=kind)
        content[kind] = stream.getvalue()
    return content


SEEDS = _seeds()


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(sorted(SEEDS)), st.data())
def test_damaged_pictures_are_read_or_refused(kind: str, data: st.DataObject):
    content = bytearray(SEEDS[kind])
    places = st.integers(0, len(content) - 1)
    for at, byte in data.draw(st.lists(st.tuples(places, st.integers(0, 255)), max_size=5)):
        content[at] = byte
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a")
        path.write_bytes(content[: data.draw(st.one_of(places, st.just(len(content))))])
        try:
            got = read_image(path, size=(9, 12))
        except GVRError as error:
            assert str(path) in str(error)
            return
    assert got.shape == (12, 9, 3)
