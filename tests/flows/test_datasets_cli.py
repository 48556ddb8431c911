"""``gvr datasets``: what is known, where it is looked for, and whether a folder can be read."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from datasets.recognise import recognise
from datasets.registry import CAPTURED, DATASETS
from gvr_core.errors import DatasetError

VARIABLES = ("GVR_DATASETS", "GVR_DATA", "GVR_SPLATS", "GVR_SHARED")


@pytest.fixture(autouse=True)
def settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for variable in VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("GVR_HOME", str(tmp_path / "home"))


@pytest.fixture
def bare(two_boxes_folder: Path, tmp_path: Path) -> Path:
    """A folder with one capture, ``ramen``: splat, cameras and pictures, without labels."""
    folder = tmp_path / "benchmarks"
    shutil.copytree(two_boxes_folder / "two-boxes", folder / "ramen")
    for name in ("scene.json", "queries.json", "labels.npy"):
        (folder / "ramen" / name).unlink()
    shutil.rmtree(folder / "ramen" / "test_masks")
    return folder


def size(root: Path) -> tuple[int, int]:
    with Image.open(root / "ramen/images/v01.png") as picture:
        return picture.size


def mask(path: Path, shape: tuple[int, int]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.zeros(shape[::-1], np.uint8)
    pixels[5:20, 5:20] = 255
    Image.fromarray(pixels).save(path)


def as_lerf_ovs(root: Path) -> None:
    width, height = size(root)
    square = [[5, 5], [20, 5], [20, 20], [5, 20]]
    thing = {"category": "red box", "segmentation": square, "bbox": [5, 5, 20, 20]}
    label: dict[str, Any] = {
        "info": {"name": "v01.png", "width": width, "height": height},
        "objects": [thing],
    }
    path = root / "label" / "ramen" / "v01.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(label))


def as_lerf_mask(root: Path) -> None:
    scene = root / "ramen"
    (scene / "images_train").mkdir()
    for path in sorted((scene / "images").iterdir()):
        if path.stem != "v01":
            shutil.copy(path, scene / "images_train")
    mask(scene / "test_mask" / "0" / "red box.png", size(root))


def as_ovs3d(root: Path) -> None:
    shape = size(root)
    (root / "ramen").rename(root / "bed")
    mask(root / "bed" / "segmentations" / "v01" / "red box.png", shape)
    (root / "bed" / "segmentations" / "classes.txt").write_text("red box\n")


LAYOUTS = {
    "lerf_ovs": (as_lerf_ovs, "label/", "ramen", "figurines, teatime, waldo_kitchen"),
    "lerf_mask": (as_lerf_mask, "ramen/test_mask/", "ramen", "figurines, teatime"),
    "ovs3d": (as_ovs3d, "bed/segmentations/", "bed", "bench, room, sofa, lawn"),
}


@pytest.mark.parametrize("layout", sorted(LAYOUTS))
def test_check_of_each_benchmark(gvr, bare: Path, layout: str):
    make, because, scene, missing = LAYOUTS[layout]
    make(bare)
    code, out, err = gvr("datasets", "check", str(bare))
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == f"{bare}: {layout}, by {because}"
    assert lines[1] == f"found: {scene}"
    assert lines[2].startswith("expected: ")
    assert lines[3] == f"missing: {missing}"
    assert lines[4].startswith(f"{scene}: ")
    assert "1 test views, 1 objects, 1 of 1 pairs labelled, 1 queries" in lines[4]
    assert f"scored by {layout}." in lines[4]


@pytest.mark.parametrize("layout", sorted(LAYOUTS))
def test_check_of_a_single_scene_of_a_benchmark(gvr, bare: Path, layout: str):
    make, _, scene, _ = LAYOUTS[layout]
    make(bare)
    code, out, err = gvr("datasets", "check", str(bare / scene))
    assert (code, err) == (0, "")
    assert f"{bare / scene}: {layout}, by " in out
    assert "missing" not in out
    assert "1 of 1 pairs labelled" in out


@pytest.mark.parametrize(
    ("layout", "file", "complaint"),
    [
        ("lerf_ovs", "label/ramen/v01.json", "v01.json"),
        ("lerf_mask", "ramen/test_mask/0/red box.png", "red box.png"),
        ("ovs3d", "bed/segmentations/v01/red box.png", "red box.png"),
        ("lerf_ovs", "ramen/sparse/0/images.txt", "images.txt"),
        ("ovs3d", "bed/point_cloud/iteration_30000/point_cloud.ply", "point_cloud.ply"),
    ],
)
def test_check_of_a_broken_file(gvr, bare: Path, layout: str, file: str, complaint: str):
    make, _, scene, _ = LAYOUTS[layout]
    make(bare)
    (bare / file).write_bytes(b"{nonsense")
    code, out, err = gvr("datasets", "check", str(bare))
    assert code == 2
    assert err.startswith(f"gvr: {scene}: ")
    assert complaint in err
    assert f"found: {scene}" in out


def test_a_broken_scene_does_not_hide_the_others(gvr, bare: Path):
    as_lerf_mask(bare)
    shutil.copytree(bare / "ramen", bare / "teatime")
    (bare / "ramen" / "point_cloud" / "iteration_30000" / "point_cloud.ply").unlink()
    code, out, err = gvr("datasets", "check", str(bare))
    assert code == 2
    assert "gvr: ramen: " in err
    assert "no trained splat" in err
    assert "teatime: " in out
    assert "1 of 1 pairs labelled" in out


def test_check_of_the_native_layout(gvr, two_boxes_folder: Path):
    for path in (two_boxes_folder, two_boxes_folder / "two-boxes"):
        code, out, err = gvr("datasets", "check", str(path))
        assert (code, err) == (0, "")
        assert f"{path}: native, by " in out
        assert "two-boxes: " in out
        assert "2 test views, 2 objects" in out
        assert "4 queries; scored by gvr.in_scene_2d" in out


def test_check_of_captures(gvr, bare: Path):
    (bare / "ramen" / "images" / "more.png").write_bytes(
        (bare / "ramen" / "images" / "v01.png").read_bytes()
    )
    code, out, err = gvr("datasets", "check", str(bare))
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == f"{bare / 'ramen'}: capture, by its cameras"
    assert lines[1].startswith("ramen: 8 registered images (8 with a picture), cameras from ")
    assert lines[2] == "  1 pictures without a camera: more.png"
    assert lines[-1].endswith("point_cloud/iteration_30000/point_cloud.ply")


def test_check_of_a_capture_without_a_splat_tells_of_its_cameras_all_the_same(gvr, shared: Path):
    plush = shared / "data" / "plush"
    code, out, err = gvr("datasets", "check", str(plush))
    assert code == 2
    assert "plush: 97 registered images (97 with a picture)" in out
    assert "  note: cameras are taken from sparse/0, not from cameras.json" in out
    assert "no trained splat" in err


def test_splats_from_another_folder(gvr, bare: Path):
    as_lerf_mask(bare)
    splats = bare.parent / "splats"
    splats.mkdir()
    ply = bare / "ramen" / "point_cloud" / "iteration_30000" / "point_cloud.ply"
    ply.rename(splats / "ramen.ply")
    assert gvr("datasets", "check", str(bare))[0] == 2
    code, out, _ = gvr("datasets", "check", str(bare), "--splats", str(splats))
    assert code == 0
    assert "1 of 1 pairs labelled" in out
    code, out, _ = gvr(
        *("datasets", "check", str(bare / "ramen"), "--as", "capture"),
        *("--splat", str(splats / "ramen.ply")),
    )
    assert code == 0
    assert out.splitlines()[-1].endswith(f"Gaussians from {splats / 'ramen.ply'}")


def test_a_folder_that_looks_like_two_layouts(gvr, bare: Path):
    as_lerf_ovs(bare)
    as_lerf_mask(bare)
    assert [item.layout for item in recognise(bare)] == ["lerf_ovs", "lerf_mask"]
    code, _, err = gvr("datasets", "check", str(bare))
    assert code == 2
    assert "looks like lerf_ovs by label/, lerf_mask by ramen/test_mask/" in err
    assert "--as" in err
    code, out, _ = gvr("datasets", "check", str(bare), "--as", "lerf_mask")
    assert code == 0
    assert f"{bare}: lerf_mask, by " in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nowhere",), "no such folder"),
        (("empty",), "looks like no data set"),
        (("ramen", "--as", "lerf"), "unknown layout 'lerf'"),
        (("ramen", "--as", "ovs3d"), "does not look like ovs3d (accepted: capture)"),
        (("empty", "--as", "native"), "looks like no data set"),
    ],
)
def test_folders_that_cannot_be_read(gvr, bare: Path, arguments: tuple[str, ...], message: str):
    (bare / "empty").mkdir()
    code, out, err = gvr("datasets", "check", str(bare / arguments[0]), *arguments[1:])
    assert (code, out) == (2, "")
    assert message in err


def test_recognise_says_what_it_accepts(tmp_path: Path):
    (tmp_path / "a.txt").touch()
    with pytest.raises(DatasetError, match=r"label/<scene>.*test_mask.*segmentations.*sparse/0"):
        recognise(tmp_path)


def listing(gvr) -> dict[str, dict[str, Any]]:
    code, out, err = gvr("datasets", "ls", "--json")
    assert (code, err) == (0, "")
    return {item["name"]: item for item in json.loads(out)["datasets"]}


def test_ls_without_any_data(gvr, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("GVR_SPLATS", str(tmp_path / "none"))
    listed = listing(gvr)
    assert list(listed) == list(DATASETS)
    assert listed["gallery"]["found"] == [f"gallery_{i}" for i in range(4)]
    assert listed["gallery"]["root"] == str(tmp_path / "home" / "data" / "gallery")
    assert "no folder of splats" in listed["composite"]["problem"]
    for name in CAPTURED:
        assert (listed[name]["root"], listed[name]["found"]) == (None, [])
        assert "GVR_DATASETS" in listed[name]["problem"]
    code, out, _ = gvr("datasets", "ls")
    assert code == 0
    assert "lerf_ovs  nowhere: GVR_DATASETS is not set" in out
    assert "  missing: ramen, figurines, teatime, waldo_kitchen" in out


def test_ls_with_a_benchmark(gvr, bare: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    as_lerf_mask(bare)
    root = tmp_path / "all" / "lerf_mask"
    shutil.copytree(bare, root)
    shutil.copytree(root / "ramen", root / "teatime")
    (root / "teatime" / "point_cloud" / "iteration_30000" / "point_cloud.ply").unlink()
    shutil.rmtree(root / "teatime" / "sparse")
    monkeypatch.setenv("GVR_DATASETS", str(tmp_path / "all"))
    listed = listing(gvr)
    assert listed["lerf_mask"] == {
        "name": "lerf_mask",
        "root": str(root),
        "made": False,
        "found": ["ramen", "teatime"],
        "missing": ["figurines", "teatime: cameras", "teatime: no trained splat"],
        "problem": None,
    }
    assert listed["ovs3d"]["root"] == str(tmp_path / "all" / "ovs3d")
    assert listed["ovs3d"]["problem"]
    _, out, _ = gvr("datasets", "ls")
    assert "  missing: figurines, teatime: cameras, teatime: no trained splat" in out


def test_where(gvr, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shared: Path):
    monkeypatch.setenv("GVR_DATASETS", str(tmp_path))
    monkeypatch.setenv("GVR_SPLATS", str(shared / "data" / "splats"))
    (tmp_path / "lerf_ovs").mkdir()
    code, out, err = gvr("datasets", "where")
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert any(line.startswith(f"GVR_DATASETS = {tmp_path}  ") for line in lines)
    assert any(line.startswith("GVR_DATA = (not set)  ") for line in lines)
    assert f"lerf_ovs: {tmp_path / 'lerf_ovs'}" in lines
    assert f"ovs3d: {tmp_path / 'ovs3d'} (not there)" in lines
    assert f"captured splats: {shared / 'data' / 'splats'}" in lines
    monkeypatch.delenv("GVR_DATASETS")
    monkeypatch.setenv("GVR_SPLATS", str(tmp_path / "none"))
    _, out, _ = gvr("datasets", "where")
    assert "lerf_ovs: nowhere: GVR_DATASETS is not set" in out
    assert "no folder of splats" in out
