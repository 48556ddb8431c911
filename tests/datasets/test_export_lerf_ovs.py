"""The writer of LERF-OVS: any mask bit for bit, the published layout, whole scenes or none."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from lerf_ovs_tree import FRAMES, SCENE, exported, label_path

from datasets.base import GroundTruth, SceneData
from datasets.export_lerf_ovs import export_lerf_ovs
from datasets.images import read_image, write_png
from datasets.lerf_ovs import LerfOvsDataset
from datasets.provenance import MARKER
from gvr_core.errors import DatasetError
from gvr_core.protocols.base import Box
from gvr_core.rendering.base import get_renderer
from gvr_core.scene import View


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[SceneData, Path]:
    return exported(tmp_path_factory.mktemp("lerf_ovs"))


@pytest.fixture
def root(made: tuple[SceneData, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(made[1], tmp_path / "tree"))


def with_masks(
    data: SceneData,
    folder: Path,
    masks: dict[str, np.ndarray],
    boxes: dict[str, tuple[Box, ...]] | None = None,
) -> SceneData:
    """The scene with other objects, seen in its first test view."""
    view = data.truth.test_views[0]
    paths = {name: folder / "masks" / f"{name}.png" for name in masks}
    for name, mask in masks.items():
        write_png(paths[name], mask)
    truth = GroundTruth(
        tuple(masks),
        (view,),
        {(view.name, name): path for name, path in paths.items()},
        boxes={(view.name, name): stated for name, stated in (boxes or {}).items()},
    )
    return replace(data, truth=truth, queries=())


def test_rings_sieves_and_dust_come_back(made: tuple[SceneData, Path], tmp_path: Path) -> None:
    data = made[0]
    view = data.truth.test_views[0]
    shape = (view.camera.height, view.camera.width)
    ring = np.zeros(shape, np.uint8)
    cv2.circle(ring, (40, 30), 25, 1, 6)
    cv2.circle(ring, (40, 30), 10, 1, 3)
    ring[30, 40] = 1
    random = np.random.default_rng(3).random(shape)
    full = np.ones(shape, bool)
    masks = {"ring": ring > 0, "sieve": random < 0.8, "dust": random < 0.1, "all": full}
    given, root = with_masks(data, tmp_path, masks), tmp_path / "tree"
    export_lerf_ovs(given, root, get_renderer("numba"))
    back = LerfOvsDataset(root).load(SCENE)
    for name, mask in masks.items():
        assert np.array_equal(back.truth.mask(back.truth.test_views[0], name), mask), name
    assert back.notes == ()


def test_stated_boxes_come_back(made: tuple[SceneData, Path], tmp_path: Path) -> None:
    data = made[0]
    view = data.truth.test_views[0]
    mask = np.zeros((view.camera.height, view.camera.width), bool)
    mask[5:10, 5:10] = mask[40:50, 60:80] = True
    boxes: tuple[Box, ...] = ((60, 40, 80, 50), (4, 4, 10, 10), (0, 0, 90, 60))
    given = with_masks(data, tmp_path, {"thing": mask}, {"thing": boxes})
    root = tmp_path / "tree"
    export_lerf_ovs(given, root, get_renderer("numba"))
    back = LerfOvsDataset(root).load(SCENE)
    assert set(back.truth.boxes["frame_00002", "thing"]) == set(boxes)
    assert np.array_equal(back.truth.mask(back.truth.test_views[0], "thing"), mask)


def test_the_layout_is_the_published_one(made: tuple[SceneData, Path]) -> None:
    root = made[1]
    content = json.loads(label_path(root).read_text())
    assert content["info"] == {
        "name": "frame_00002.jpg", "width": 96, "height": 72, "depth": 3, "note": "",
    }  # fmt: skip
    assert set(content["objects"][0]) == {
        "category", "group", "segmentation", "area", "layer", "bbox", "iscrowd", "note",
    }  # fmt: skip
    assert sorted(p.name for p in (root / "label" / SCENE).iterdir()) == [
        f"{frame}.{suffix}" for frame in FRAMES for suffix in ("jpg", "json")
    ]
    assert sorted(p.name for p in (root / SCENE).iterdir()) == [
        MARKER, "images", "point_cloud", "sparse",
    ]  # fmt: skip


def test_an_export_does_not_replace_anything(made: tuple[SceneData, Path], root: Path) -> None:
    data, renderer = made[0], get_renderer("numba")
    before = {p: p.read_bytes() for p in root.rglob("*") if p.is_file()}
    with pytest.raises(DatasetError, match="something already"):
        export_lerf_ovs(data, root, renderer)
    shutil.rmtree(root / "label" / SCENE)
    with pytest.raises(DatasetError, match="something already"):
        export_lerf_ovs(data, root, renderer)
    after = {p: p.read_bytes() for p in root.rglob("*") if p.is_file()}
    assert after == {p: raw for p, raw in before.items() if "label" not in p.parts}


def test_a_scene_that_cannot_be_told_apart_is_not_exported(
    made: tuple[SceneData, Path], tmp_path: Path
) -> None:
    data, renderer = made[0], get_renderer("numba")
    with pytest.raises(DatasetError, match="a scene named 'label'"):
        export_lerf_ovs(replace(data, scene=replace(data.scene, name="label")), tmp_path, renderer)
    with pytest.raises(DatasetError, match="no test view shows an object"):
        export_lerf_ovs(with_masks(data, tmp_path, {}), tmp_path, renderer)
    assert not list(tmp_path.iterdir())


def test_views_without_a_picture_are_rendered(made: tuple[SceneData, Path], tmp_path: Path) -> None:
    data = made[0]

    def bare(views: tuple[View, ...]) -> tuple[View, ...]:
        return tuple(replace(view, image=None) for view in views)

    blind = replace(
        data,
        scene=replace(data.scene, views=bare(data.scene.views)),
        truth=replace(data.truth, test_views=bare(data.truth.test_views)),
    )
    export_lerf_ovs(blind, tmp_path, get_renderer("numba"))
    for view in LerfOvsDataset(tmp_path).load(SCENE).scene.views:
        drawn = read_image(view.image).astype(int)
        stored = read_image(made[1] / SCENE / "images" / f"{view.name}.jpg")
        assert np.abs(drawn - stored).mean() < 1 and drawn.std() > 10


KILLED = """
import os, sys
from pathlib import Path
import datasets.export_lerf_ovs, datasets.exporting
from datasets.native import read_scene
from gvr_core.rendering.base import get_renderer

def deadly(path):
    os.kill(os.getpid(), 9)

setattr(sys.modules[sys.argv[3]], sys.argv[4], deadly)
data = read_scene(Path(sys.argv[1]))
datasets.export_lerf_ovs.export_lerf_ovs(data, Path(sys.argv[2]), get_renderer("numba"))
"""


def killed_at(made: tuple[SceneData, Path], root: Path, module: str, function: str) -> None:
    """An export that dies when it first calls a function."""
    native = made[1].parent / "native" / SCENE
    command = [sys.executable, "-c", KILLED, str(native), str(root), module, function]
    ended = subprocess.run(command, cwd=Path(__file__).parents[2], check=False)
    assert ended.returncode == -signal.SIGKILL


def test_a_killed_export_leaves_no_scene(made: tuple[SceneData, Path], tmp_path: Path) -> None:
    killed_at(made, tmp_path, "datasets.export_lerf_ovs", "atomic_write")
    assert not (tmp_path / SCENE).exists() and not (tmp_path / "label" / SCENE).exists()
    assert list(tmp_path.rglob("frame_00001.jpg")), "it was killed before it wrote anything"
    with pytest.raises(DatasetError, match="no scene has labels"):
        LerfOvsDataset(tmp_path).scenes()
    export_lerf_ovs(made[0], tmp_path, get_renderer("numba"))
    assert LerfOvsDataset(tmp_path).load(SCENE).notes == ()


def test_labels_come_last(made: tuple[SceneData, Path], tmp_path: Path) -> None:
    killed_at(made, tmp_path, "datasets.exporting", "sync_folder")
    assert (tmp_path / SCENE / "images").is_dir() and not (tmp_path / "label" / SCENE).exists()
    with pytest.raises(DatasetError, match="no scene has labels"):
        LerfOvsDataset(tmp_path).scenes()
