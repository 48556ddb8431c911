"""Where the trained splat of a scene is looked for."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_captures import (
    ITERATION,
    SCENE,
    other_gaussians,
    some_gaussians,
    write_capture,
)

from datasets.capture import Capture, read_capture
from datasets.splat_places import find_splat, model_folder
from gvr_core.errors import DatasetError, SplatFormatError
from gvr_core.splat_io import write_ply


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_capture(tmp_path / SCENE)


def read(folder: Path, **named: Path) -> Capture:
    return read_capture(folder, SCENE, **named)


@pytest.mark.parametrize(
    "place",
    [
        ITERATION.format(7),
        "output/" + ITERATION.format(30000),
        "output/ramen/" + ITERATION.format(30000),
        "ramen.ply",
        "point_cloud.ply",
        "output/ramen.ply",
        "output/point_cloud.ply",
    ],
)
def test_splats_by_convention(tmp_path: Path, place: str):
    write_ply(tmp_path / place, some_gaussians())
    (tmp_path / "input.ply").touch()
    assert find_splat(tmp_path, "ramen") == tmp_path / place
    model = tmp_path / place.removesuffix(place[place.find("point_cloud") :])
    assert model_folder(tmp_path / place) == (model if "iteration" in place else None)


def test_the_largest_number_of_iterations(tmp_path: Path):
    for number in ("7000", "30000", "9000"):
        write_ply(tmp_path / ITERATION.format(number), some_gaussians())
    (tmp_path / "point_cloud" / "iteration_60000").mkdir()  # the training is still at it
    write_ply(tmp_path / ITERATION.format("best"), other_gaussians())
    assert find_splat(tmp_path, "ramen") == tmp_path / ITERATION.format(30000)


@pytest.mark.parametrize(
    "place", ["ramen.ply", "ramen/" + ITERATION.format(30000), "ramen/point_cloud.ply"]
)
def test_a_folder_of_splats(folder: Path, tmp_path: Path, place: str):
    path = tmp_path / "splats" / place
    write_ply(path, other_gaussians())
    assert read(folder, splats=tmp_path / "splats").ply == path


def test_a_splat_that_is_named(folder: Path, tmp_path: Path):
    named = tmp_path / "elsewhere" / "mine.ply"
    write_ply(named, other_gaussians())
    write_ply(folder / "again" / ITERATION.format(10), other_gaussians())
    assert read(folder, splat=named).ply == named
    assert read(folder, splat=Path("again")).ply == folder / "again" / ITERATION.format(10)


def test_two_splats_that_differ_are_refused_and_one_can_be_named(folder: Path):
    write_ply(folder / "ramen.ply", some_gaussians())
    assert read(folder).ply == folder / ITERATION.format(30000)  # the same to the last byte
    write_ply(folder / "ramen.ply", other_gaussians())
    with pytest.raises(DatasetError, match="several splats that differ") as caught:
        read(folder)
    assert ITERATION.format(30000) in str(caught.value)
    assert "ramen.ply" in str(caught.value)
    assert read(folder, splat=Path("ramen.ply")).ply == folder / "ramen.ply"


def test_splats_of_one_size_that_differ_are_refused(tmp_path: Path):
    write_ply(tmp_path / "ramen.ply", some_gaussians())
    content = bytearray((tmp_path / "ramen.ply").read_bytes())
    content[-1] ^= 1
    (tmp_path / "point_cloud.ply").write_bytes(content)
    with pytest.raises(DatasetError, match=r"several splats that differ: ramen\.ply, point_cloud"):
        find_splat(tmp_path, "ramen")


def test_no_splat(folder: Path, tmp_path: Path):
    (folder / ITERATION.format(30000)).unlink()
    (folder / "input.ply").touch()
    with pytest.raises(DatasetError, match=r"no trained splat .*iteration_N.*setting splat"):
        read(folder)
    with pytest.raises(DatasetError, match="no such splat"):
        read(folder, splat=Path("ramen.ply"))
    with pytest.raises(DatasetError, match="no trained splat"):
        read(folder, splat=Path("images"))
    with pytest.raises(DatasetError, match="no folder of splats"):
        read(folder, splats=tmp_path / "nowhere")
    (tmp_path / "splats").mkdir()
    with pytest.raises(DatasetError, match=r"no trained splat .*ramen\.ply, or ramen/point_cloud"):
        read(folder, splats=tmp_path / "splats")
    (folder / "ramen.ply").write_bytes(b"ply\nnonsense\n")
    with pytest.raises(SplatFormatError):
        read(folder)
