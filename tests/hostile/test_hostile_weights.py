"""Spoilt weights: refused with an error of ours, or read; what they ask for is not done."""

from __future__ import annotations

import io
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hostile_inputs import damaged, quickly, read, seeds
from hostile_targets import evil, in_archive
from hypothesis import given
from hypothesis import strategies as st

from gvr_core.weights.pickles import AsksForMore, check_pickles

NAMES = ["torch-file", "torch-pickle", "safetensors", "onnx"]


@pytest.mark.parametrize("name", NAMES)
@quickly
@given(data=st.data())
def test_damaged_files(name: str, data: st.DataObject) -> None:
    read(name, data.draw(damaged(name)))


def doubled(times: int) -> bytes:
    """A dict whose key is a tuple of two tuples of two tuples and so on."""
    return b"\x80\x02}q\x00K\x01" + b"q\x01h\x01\x86" * times + b"K\x01s."


def hexed(times: int) -> bytes:
    """A text that is encoded to twice its length so many times."""
    text = b"X\x02\x00\x00\x00\xc3\xa9X\x06\x00\x00\x00latin1\x86R"
    step = b"q\x01ccodecs\nencode\nh\x01X\x03\x00\x00\x00hex\x86R".replace(b"codecs", b"_codecs")
    return b"\x80\x02c_codecs\nencode\n" + text + step * times + b"."


HUNGRY = {
    "bytearray": b"\x80\x02cbuiltins\nbytearray\n\x8a\x05\x00\x00\x00\x00\x10\x85R.",
    "bytearray as Python 2 calls it": (
        b"\x80\x02c__builtin__\nbytearray\n\x8a\x05\x00\x00\x00\x00\x10\x85R."
    ),
    "encode": hexed(40),
    "hash": doubled(60),
    "code": evil("exit 1"),
}


@pytest.mark.parametrize("content", HUNGRY.values(), ids=HUNGRY)
@pytest.mark.parametrize("wrap", [in_archive, bytes], ids=["archive", "bare"])
def test_what_pickles_ask_for_is_read_before_it_is_done(content: bytes, wrap) -> None:  # type: ignore[no-untyped-def]
    began = time.monotonic()
    with pytest.raises(AsksForMore):
        check_pickles(io.BytesIO(wrap(content)))
    assert not read("torch-file", wrap(content))
    assert time.monotonic() - began < 10


def packed(compression: int) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as archive:
        archive.writestr("archive/data.pkl", seeds("torch-pickle")[0])
        archive.writestr("archive/data/0", bytes(2**22))
        archive.writestr("archive/version", b"3\n")
    return file.getvalue()


def test_a_packed_archive_is_refused() -> None:
    with pytest.raises(AsksForMore, match="compressed"):
        check_pickles(io.BytesIO(packed(zipfile.ZIP_DEFLATED)))
    check_pickles(io.BytesIO(packed(zipfile.ZIP_STORED)))


def test_entries_that_lie_over_each_other_are_refused() -> None:
    content = bytearray(packed(zipfile.ZIP_STORED))
    end = content.rindex(b"PK\x05\x06")
    for entry in range(2):  # the directory says of each entry that it is as large as the file
        at = content.index(b"PK\x01\x02")
        for _ in range(entry):
            at = content.index(b"PK\x01\x02", at + 4)
        content[at + 20 : at + 28] = np.array([len(content) - 100] * 2, "<u4").tobytes()
    assert end > 0
    with pytest.raises(AsksForMore, match="larger than the archive"):
        check_pickles(io.BytesIO(bytes(content)))


def test_tensors_pass_and_the_file_is_where_it_was(tmp_path: Path) -> None:
    for seed in seeds("torch-file"):
        file = io.BytesIO(seed)
        check_pickles(file)
        assert file.tell() == 0


@pytest.mark.parametrize("dtype", ["BF16", "F8_E4M3", "F8_E5M2", "U64", "F4", "C64", "XX"])
@pytest.mark.parametrize("name", ["safetensors", "stored-arrays"])
def test_dtypes_that_not_everybody_has(name: str, dtype: str) -> None:
    header = f'{{"a":{{"dtype":"{dtype}","shape":[4],"data_offsets":[0,8]}}}}'.encode()
    read(name, len(header).to_bytes(8, "little") + header + bytes(8))
    promise = header.replace(b"[4]", b"[1099511627776]").replace(b"8]", b"8796093022208]")
    assert not read(name, len(promise).to_bytes(8, "little") + promise + bytes(8))
    assert not read(name, (2**63).to_bytes(8, "little") + header)


def test_what_is_spoilt_was_good() -> None:
    for name in NAMES:
        assert all(read(name, seed) for seed in seeds(name))


def graph(names: list[str], **node: list[str]) -> bytes:
    """A decoder whose outputs are made by one node each, in ONNX."""
    from onnx import TensorProto, helper

    from gvr_core.models.sam_onnx import DECODER_INPUTS

    def value(name: str) -> object:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, [1])

    nodes = [helper.make_node("Relu", node.get(name, ["point_coords"]), [name]) for name in names]
    made = helper.make_graph(nodes, "g", list(map(value, DECODER_INPUTS)), list(map(value, names)))
    return bytes(helper.make_model(made).SerializeToString())


OUTPUTS = ["masks", "iou_predictions", "low_res_masks"]


def test_graphs_that_run_in_circles_or_begin_nowhere() -> None:
    assert not read("onnx", graph(OUTPUTS))
    assert not read("onnx", graph(OUTPUTS, low_res_masks=["low_res_masks"]))
    assert not read("onnx", graph(OUTPUTS, low_res_masks=["masks"], masks=["low_res_masks"]))
    assert not read("onnx", graph(OUTPUTS, low_res_masks=[]))


def test_weights_in_other_files_inside_of_nodes(tmp_path: Path) -> None:
    import onnx

    from gvr_core.errors import ModelError
    from gvr_core.models.sam_onnx import _graph

    model = onnx.load_model_from_string(seeds("onnx")[0])
    tensor = onnx.TensorProto(name="t", data_type=1, dims=[1], data_location=1)
    tensor.external_data.add(key="location", value="../../etc/passwd")
    inner = onnx.helper.make_graph([], "inner", [], [], [tensor])
    for name, value in (("value", tensor), ("body", inner)):
        spoilt = onnx.ModelProto()
        spoilt.CopyFrom(model)
        spoilt.graph.node.append(onnx.helper.make_node("Loop", [], ["y"], **{name: value}))
        with pytest.raises(ModelError, match="in other files"):
            _graph(spoilt.SerializeToString(), tmp_path / "a.onnx")
