"""Exports that cannot be: refused, or failing on the way; nothing is half-written."""

from __future__ import annotations

import errno
import os
import resource
from pathlib import Path

import numpy as np
import pytest
from splat_files import as_trained, save_vertex, some_flags, some_gaussians

from gvr_core import exports
from gvr_core.errors import SplatFormatError
from gvr_core.exports import write_dyed, write_target, write_without
from gvr_core.gaussians import Gaussians
from gvr_core.splat_io import read_ply, write_ply


@pytest.mark.parametrize(
    ("write", "flags", "expected"),
    [
        (write_target, np.ones(19, bool), r"shape \(19,\).*shape \(20,\)"),
        (write_dyed, np.ones(20, int), "int64.*bool"),
        (write_target, np.zeros(20, bool), "no Gaussian would be left"),
        (write_without, np.ones(20, bool), "no Gaussian would be left"),
    ],
)
@pytest.mark.parametrize("in_memory", [False, True])
def test_flags_that_cannot_be_used_write_nothing(
    tmp_path: Path, write, flags, expected: str, in_memory: bool
) -> None:
    source: Path | Gaussians = some_gaussians(20)
    if not in_memory:
        write_ply(tmp_path / "scene.ply", some_gaussians(20))
        source = tmp_path / "scene.ply"
    before = sorted(tmp_path.iterdir())
    with pytest.raises(SplatFormatError, match=expected):
        write(tmp_path / "out.ply", source, flags)
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("suffix", [".ply", ".splat"])
def test_the_source_is_never_replaced(tmp_path: Path, suffix: str) -> None:
    source = tmp_path / f"scene{suffix}"
    write_ply(source, some_gaussians(20))
    before = source.read_bytes()
    (tmp_path / "link").symlink_to(source)
    for path in (source, tmp_path / "link"):
        with pytest.raises(SplatFormatError, match="would be replaced"):
            write_target(path, source, some_flags(20))
    assert source.read_bytes() == before


def test_what_is_no_set_of_gaussians_is_refused(tmp_path: Path) -> None:
    points = np.zeros(4, [("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    source = save_vertex(tmp_path / "points.ply", points)
    with pytest.raises(SplatFormatError, match="f_dc_0"):
        write_target(tmp_path / "out.ply", source, np.ones(4, bool))
    assert list(tmp_path.iterdir()) == [source]


@pytest.mark.parametrize("write", [write_target, write_without, write_dyed])
@pytest.mark.parametrize("in_memory", [False, True])
def test_a_full_disk_leaves_the_old_file(tmp_path: Path, write, in_memory: bool) -> None:
    scene, path = save_vertex(tmp_path / "scene.ply", as_trained(5000, 3)), tmp_path / "out.ply"
    path.write_bytes(b"an older file")
    source, flags = read_ply(scene) if in_memory else scene, some_flags(5000)
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, old[1]))
    try:
        with pytest.raises(OSError, match=os.strerror(errno.EFBIG)):
            write(path, source, flags)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
    assert path.read_bytes() == b"an older file"
    assert sorted(tmp_path.iterdir()) == [path, scene]


def test_a_source_that_breaks_off_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, path = save_vertex(tmp_path / "scene.ply", as_trained(50, 1)), tmp_path / "out.ply"
    path.write_bytes(b"an older file")
    blocks = exports.vertex_blocks

    def shrinking(stream, table, name):
        os.truncate(name, table.offset + 20 * table.dtype.itemsize)
        return blocks(stream, table, name)

    monkeypatch.setattr(exports, "vertex_blocks", shrinking)
    with pytest.raises(SplatFormatError, match="ends early"):
        write_target(path, source, some_flags(50))
    assert path.read_bytes() == b"an older file"
    assert sorted(tmp_path.iterdir()) == [path, source]


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path: Path) -> None:
    source = save_vertex(tmp_path / "scene.ply", as_trained(5, 0))
    with pytest.raises(OSError, match=os.strerror(errno.ENOTDIR)):
        write_target(source / "sub" / "t.ply", source, some_flags(5))
    assert list(tmp_path.iterdir()) == [source]
