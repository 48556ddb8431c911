"""Spoilt pictures and predictions: refused with an error of ours, or read."""

from __future__ import annotations

import io

import numpy as np
import pytest
from hostile_inputs import damaged, quickly, read, seeds
from hypothesis import given
from hypothesis import strategies as st

PREDICTIONS = ["predictions-png", "predictions-maps", "predictions-flags"]


@pytest.mark.parametrize("name", ["picture", *PREDICTIONS])
@quickly
@given(data=st.data())
def test_damaged_files(name: str, data: st.DataObject) -> None:
    read(name, data.draw(damaged(name)))


HEADERS = [
    "{'descr': '<f4', 'fortran_order': False, 'shape': (1099511627776,), }",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (4294967296, 4294967296), }",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (-1,), }",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (), }",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (True,), }",
    "{'descr': '|O', 'fortran_order': False, 'shape': (2,), }",
    "{'descr': '|V0', 'fortran_order': False, 'shape': (9999999,), }",
    "{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (1,), }",
    "{'descr': '<f4', 'fortran_order': 3, 'shape': (1,), }",
    "{'descr': '<U99999999', 'fortran_order': False, 'shape': (0,), }",
    "{'descr': 7, 'shape': 7}",
    "(" * 3000 + ")" * 3000,
    "[" * 200,
    "{" + "-" * 5000 + "1: 2}",
    "__import__('os').system('exit 1')",
    "9" * 6000,
]


@pytest.mark.parametrize("name", ["labels-npy", "predictions-maps", "predictions-flags"])
@pytest.mark.parametrize("header", HEADERS)
def test_headers_of_arrays_that_lie(name: str, header: str) -> None:
    text = header.encode() + b"\n"
    data = b"\x93NUMPY\x02\x00" + len(text).to_bytes(4, "little") + text + bytes(8)
    assert not read(name, data)


def archive() -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, a=np.zeros(10**6))
    return file.getvalue()


@pytest.mark.parametrize("name", ["labels-npy", "predictions-maps", "predictions-flags"])
@pytest.mark.parametrize(
    "data", [archive(), b"PK\x03\x04nothing", b"\x80\x04N.", b"", b"\x93NUMPY\x09\x09"]
)
def test_what_numpy_would_open_but_is_no_array(name: str, data: bytes) -> None:
    assert not read(name, data)


def test_what_is_spoilt_was_good() -> None:
    for name in ("picture", *PREDICTIONS):
        assert all(read(name, seed) for seed in seeds(name))
