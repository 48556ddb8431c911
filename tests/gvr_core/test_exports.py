"""Exports: what is kept is kept to the last bit, and what is dyed is dyed.

plyfile's own reader is the judge of what was written.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement
from splat_files import (
    as_trained,
    bits,
    columns,
    same,
    save_vertex,
    some_flags,
    some_gaussians,
    vertex_of,
)

from gvr_core import ply_rows
from gvr_core.cameras import Camera, intrinsics, look_at
from gvr_core.dot_splat_io import RECORD
from gvr_core.errors import ConfigError
from gvr_core.exports import (
    RED,
    parse_colour,
    write_dyed,
    write_indices,
    write_target,
    write_without,
)
from gvr_core.rendering import get_renderer
from gvr_core.splat_io import read_ply, read_splat, write_ply

GREENISH = (0.2, 0.8, 0.4)


@st.composite
def flagged_vertices(draw: st.DrawFn) -> tuple[NDArray, NDArray[np.bool_]]:
    n = draw(st.integers(2, 40))
    vertex = as_trained(n, draw(st.integers(0, 3)), draw(st.integers(0, 2**32 - 1)))
    flags = draw(hnp.arrays(np.bool_, n).filter(lambda flags: flags.any() and not flags.all()))
    return vertex, flags


@settings(max_examples=60, deadline=None)
@given(flagged_vertices())
def test_kept_rows_are_the_sources_to_the_last_bit(case: tuple[NDArray, NDArray[np.bool_]]) -> None:
    vertex, flags = case
    with tempfile.TemporaryDirectory() as folder:
        source = save_vertex(Path(folder, "scene.ply"), vertex)
        target, without = Path(folder, "t.ply"), Path(folder, "w.ply")
        write_target(target, source, flags)
        write_without(without, source, flags)
        scene, alone, rest = read_ply(source), read_ply(target), read_ply(without)
        assert vertex_of(target).dtype == vertex_of(without).dtype == vertex.dtype
        assert bits(vertex_of(target)) == bits(vertex[flags])
        assert bits(vertex_of(without)) == bits(vertex[~flags])
    assert same(alone, scene.subset(flags))
    assert same(rest, scene.subset(~flags))


@settings(max_examples=60, deadline=None)
@given(flagged_vertices(), st.tuples(*[st.floats(0, 1)] * 3))
def test_dyeing_changes_the_targets_colour_and_nothing_else(
    case: tuple[NDArray, NDArray[np.bool_]], rgb: tuple[float, float, float]
) -> None:
    vertex, flags = case
    with tempfile.TemporaryDirectory() as folder:
        source, path = save_vertex(Path(folder, "scene.ply"), vertex), Path(folder, "dyed.ply")
        write_dyed(path, source, flags, rgb)
        dyed, got = vertex_of(path), read_ply(path)
        expected = read_ply(source).dyed(flags, rgb)
    assert dyed.dtype == vertex.dtype
    assert bits(dyed[~flags]) == bits(vertex[~flags])
    others = [name for name in vertex.dtype.names if not name.startswith("f_")]
    assert bits(dyed[others]) == bits(vertex[others])
    assert not got.sh[flags, 1:].any()
    colours = 0.5 + 0.28209479177387814 * got.sh[flags, 0]
    np.testing.assert_allclose(colours, np.tile(rgb, (flags.sum(), 1)), atol=1e-6)
    assert same(got, expected)


def test_the_target_looks_dyed_from_every_side(tmp_path: Path) -> None:
    gaussians = some_gaussians(1, degree=3)
    gaussians.means[:], gaussians.scales[:], gaussians.opacities[:] = 0, 0.3, 0.999
    write_ply(tmp_path / "scene.ply", gaussians)
    write_dyed(tmp_path / "dyed.ply", tmp_path / "scene.ply", np.array([True]), GREENISH)
    before, after = [], []
    for eye in ((2, 0, 0.1), (-2, 0.1, 0), (0.1, 2, 0), (0, -2, 0.1), (0, 0.1, 2), (0.1, 0, -2)):
        pose = look_at(np.array(eye, float), (0, 0, 0), np.array([0.3, 0.4, 0.5]))
        camera = Camera(intrinsics(40, 33, 33), pose, 33, 33)
        for name, pixels in (("scene", before), ("dyed", after)):
            image = get_renderer("numba").render(read_ply(tmp_path / f"{name}.ply"), camera)
            pixels.append(image.rgb[16, 16] / image.alpha[16, 16])
    assert np.ptp(before, axis=0).max() > 0.1  # the source's colour does depend on the side
    np.testing.assert_allclose(after, np.tile(GREENISH, (6, 1)), atol=2e-3)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_columns_have_their_standard_names(tmp_path: Path, degree: int) -> None:
    gaussians, flags = some_gaussians(12, degree), some_flags(12)
    write_ply(tmp_path / "scene.ply", gaussians)
    for source in (tmp_path / "scene.ply", gaussians):
        for write in (write_target, write_without, write_dyed):
            write(tmp_path / "out.ply", source, flags)
            assert list(vertex_of(tmp_path / "out.ply").dtype.names) == columns(degree)


def test_columns_and_comments_that_mean_nothing_to_us_are_kept(tmp_path: Path) -> None:
    plain, flags = as_trained(30, 1), some_flags(30)
    dtype = [("id", "<i4"), *plain.dtype.descr, ("weight", "<f8"), ("tag", "u1")]
    vertex = np.zeros(30, dtype)
    for name in plain.dtype.names:
        vertex[name] = plain[name]
    vertex["id"], vertex["weight"] = np.arange(30) - 7, np.pi * np.arange(30)
    vertex["weight"][4], vertex["tag"] = np.nan, 255
    faces = np.empty(2, [("vertex_indices", "i4", (3,))])
    faces["vertex_indices"] = 1
    source = tmp_path / "scene.ply"
    elements = [PlyElement.describe(vertex, "vertex"), PlyElement.describe(faces, "face")]
    PlyData(elements, byte_order=">", comments=["Vertical axis: z"]).write(source)
    write_target(tmp_path / "t.ply", source, flags)
    got = PlyData.read(tmp_path / "t.ply")
    assert got.byte_order == "<"
    assert got.comments == ["Vertical axis: z"]
    assert [element.name for element in got.elements] == ["vertex"]
    assert bits(np.array(got["vertex"].data)) == bits(vertex[flags])


def test_text_becomes_the_same_numbers_in_bytes(tmp_path: Path) -> None:
    vertex, flags = as_trained(30, 2), some_flags(30)
    source = save_vertex(tmp_path / "scene.ply", vertex, text=True)
    write_without(tmp_path / "w.ply", source, flags)
    assert not PlyData.read(tmp_path / "w.ply").text
    np.testing.assert_array_equal(vertex_of(tmp_path / "w.ply"), vertex_of(source)[~flags])


def test_infinite_logits_stay(tmp_path: Path) -> None:
    vertex = as_trained(6, 0)
    vertex["opacity"][:3] = np.inf, -np.inf, 40
    source = save_vertex(tmp_path / "scene.ply", vertex)
    write_target(tmp_path / "t.ply", source, np.array([True, True, True, False, False, False]))
    assert vertex_of(tmp_path / "t.ply")["opacity"].tolist() == [np.inf, -np.inf, 40]


def test_rows_of_many_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ply_rows, "BLOCK_ROWS", 7)
    vertex = as_trained(50, 1)
    flags = np.zeros(50, bool)
    flags[[0, 6, 7, 13, 41, 48, 49]] = True  # block 2 has none
    source = save_vertex(tmp_path / "scene.ply", vertex)
    write_target(tmp_path / "t.ply", source, flags)
    write_dyed(tmp_path / "d.ply", source, flags)
    assert bits(vertex_of(tmp_path / "t.ply")) == bits(vertex[flags])
    assert same(read_ply(tmp_path / "d.ply"), read_ply(source).dyed(flags, RED))


def test_a_dot_splat_becomes_a_ply(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    records = np.zeros(40, RECORD)
    records["mean"], records["scale"] = rng.normal(size=(40, 3)), rng.random((40, 3))
    records["rgba"], records["quat"] = rng.integers(0, 256, (2, 40, 4))
    source = tmp_path / "scene.splat"
    source.write_bytes(records.tobytes())
    scene, flags = read_splat(source), some_flags(40)
    write_target(tmp_path / "t.ply", source, flags)
    write_without(tmp_path / "w.ply", source, flags)
    write_dyed(tmp_path / "d.ply", source, flags, GREENISH)
    for name, expected in {
        "t": scene.subset(flags),
        "w": scene.subset(~flags),
        "d": scene.dyed(flags, GREENISH),
    }.items():
        got = read_ply(tmp_path / f"{name}.ply")
        np.testing.assert_array_equal(got.means, expected.means)
        np.testing.assert_array_equal(got.sh, expected.sh)
        np.testing.assert_allclose(got.scales, expected.scales, rtol=1e-6)
        np.testing.assert_allclose(got.opacities, expected.opacities, rtol=1e-6)
        np.testing.assert_allclose(got.quats, expected.quats, atol=1.2e-7)


@given(hnp.arrays(np.bool_, st.integers(0, 60)))
@settings(max_examples=40, deadline=None)
def test_indices_and_flags_say_the_same(flags: NDArray[np.bool_]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        write_indices(Path(folder, "i.npy"), flags)
        indices = np.load(Path(folder, "i.npy"), allow_pickle=False)
    assert indices.dtype == np.int64
    assert indices.tolist() == [row for row, flag in enumerate(flags) if flag]
    again = np.zeros(len(flags), bool)
    again[indices] = True
    np.testing.assert_array_equal(again, flags)


@pytest.mark.parametrize(
    ("text", "rgb"),
    [("#ff0000", (1, 0, 0)), ("00FF00", (0, 1, 0)), (" #336699 ", (0.2, 0.4, 0.6))],
)
def test_colours(text: str, rgb: tuple[float, float, float]) -> None:
    assert parse_colour(text) == pytest.approx(rgb)


@pytest.mark.parametrize("text", ["", "red", "#ff00", "#ff00000", "255,0,0", "#gg0000", "#ff٣٣00"])
def test_other_colours_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="#ff0000"):
        parse_colour(text)


@pytest.mark.parametrize("name", ["biker", "guitar"])
def test_real_captures_keep_every_bit(shared: Path, tmp_path: Path, name: str) -> None:
    source = shared / "data" / "splats" / f"{name}.ply"
    vertex = vertex_of(source)
    flags = np.random.default_rng(0).random(len(vertex)) < 0.1
    write_target(tmp_path / "t.ply", source, flags)
    write_without(tmp_path / "w.ply", source, flags)
    assert bits(vertex_of(tmp_path / "t.ply")) == bits(vertex[flags])
    assert bits(vertex_of(tmp_path / "w.ply")) == bits(vertex[~flags])
