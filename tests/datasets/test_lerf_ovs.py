"""LERF-OVS: what is exported is read back as it was, and real label files are read as published."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from lerf_ovs_tree import FRAMES, SCENE, edit, exported
from PIL import Image

from datasets.base import SceneData
from datasets.colmap import read_colmap_model, write_colmap_text
from datasets.export_lerf_ovs import frame_stems
from datasets.images import read_image
from datasets.leakage import without_test_views
from datasets.lerf_ovs import SCENES, LerfOvsDataset
from gvr_core.errors import ConfigError, DatasetError
from gvr_core.protocols import PROTOCOLS


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[SceneData, Path]:
    return exported(tmp_path_factory.mktemp("lerf_ovs"))


@pytest.fixture
def root(made: tuple[SceneData, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(made[1], tmp_path / "tree"))


def category(data: SceneData, target: str) -> str:
    """What an object is called in the tree: its first wording."""
    return next(query.text for query in data.queries if query.target == target)


def test_masks_come_back_bit_for_bit(made: tuple[SceneData, Path]) -> None:
    data, root = made
    back = LerfOvsDataset(root).load(SCENE)
    stems = frame_stems(data)
    assert [view.name for view in back.truth.test_views] == list(FRAMES)
    shown = 0
    for view in data.truth.test_views:
        read = next(v for v in back.truth.test_views if v.name == stems[view.name])
        for target in data.truth.objects:
            mask = data.truth.mask(view, target)
            text = category(data, target)
            assert np.array_equal(back.truth.mask(read, text), mask)
            assert back.truth.is_labelled(read, text) == mask.any()
            shown += int(mask.any())
    assert shown == 4 == len(back.truth.masks)


def test_queries_are_the_categories(made: tuple[SceneData, Path]) -> None:
    back = LerfOvsDataset(made[1]).load(SCENE)
    assert [(q.id, q.text, q.target, q.absent) for q in back.queries] == [
        ("a-red-box", "a red box", "a red box", False),
        ("a-blue-box", "a blue box", "a blue box", False),
    ]
    assert back.truth.objects == ("a red box", "a blue box")


def test_cameras_gaussians_and_photographs_come_back(made: tuple[SceneData, Path]) -> None:
    data, root = made
    back = LerfOvsDataset(root).load(SCENE)
    stems = frame_stems(data)
    before = {stems[v.name]: v for v in (*data.scene.views, *data.truth.test_views)}
    assert [view.name for view in back.scene.views] == sorted(before)
    for view in (*back.scene.views, *back.truth.test_views):
        camera = before[view.name].camera
        assert (view.camera.width, view.camera.height) == (camera.width, camera.height)
        np.testing.assert_allclose(view.camera.K, camera.K, atol=1e-6)
        np.testing.assert_allclose(view.camera.world_to_camera, camera.world_to_camera, atol=1e-6)
        assert view.image is not None and view.image.read_bytes()[:3] == b"\xff\xd8\xff"
        off = read_image(view.image).astype(int) - read_image(before[view.name].image)
        assert np.abs(off).mean() < 3
    for part in ("means", "scales", "quats", "opacities", "sh"):
        was, read = getattr(data.scene.gaussians, part), getattr(back.scene.gaussians, part)
        np.testing.assert_allclose(read, was, atol=1e-6)
    assert (back.scene.dataset, back.scene.name, back.scene.up) == ("lerf_ovs", SCENE, None)


def test_boxes_are_those_of_the_masks(made: tuple[SceneData, Path]) -> None:
    back = LerfOvsDataset(made[1]).load(SCENE)
    for (name, text), boxes in back.truth.boxes.items():
        view = next(v for v in back.truth.test_views if v.name == name)
        rows, columns = np.nonzero(back.truth.mask(view, text))
        assert set(boxes) == {(columns.min(), rows.min(), columns.max(), rows.max())}


def test_no_repair_is_needed_and_the_protocols_are_known(made: tuple[SceneData, Path]) -> None:
    back = LerfOvsDataset(made[1]).load(SCENE)
    assert back.notes == ()
    assert back.protocols == (
        "lerf_ovs.langsplat_2d/1",
        "lerf_ovs.opengaussian_3d/1",
        "gvr.in_scene_2d/1",
        "refusal/1",
    )
    assert set(back.protocols) <= set(PROTOCOLS)
    assert back.truth.labels is None


def test_the_leakage_audit_finds_the_labelled_frames(made: tuple[SceneData, Path]) -> None:
    audited = without_test_views(LerfOvsDataset(made[1]).load(SCENE))
    assert [v.name for v in audited.scene.views] == ["frame_00001", "frame_00003", "frame_00004"]


def langsplat_masks(path: Path) -> dict[str, np.ndarray]:
    """The masks of a label file, written down from what LangSplat's evaluator computes."""
    content = json.loads(path.read_text())
    masks: dict[str, np.ndarray] = {}
    for item in content["objects"]:
        mask = np.zeros((content["info"]["height"], content["info"]["width"]), dtype=np.uint8)
        cv2.fillPoly(mask, [np.array(item["segmentation"]).astype(np.int32)], 1)
        masks[item["category"]] = np.logical_or(masks.get(item["category"], 0), mask)
    return masks


def test_masks_are_those_of_the_published_evaluator(root: Path) -> None:
    corners = np.random.default_rng(5).uniform((0, 0), (95, 71), (40, 6, 2)).round(2).tolist()

    def change(content: dict) -> None:
        content["objects"] = [
            {"category": f"thing {i % 7}", "segmentation": polygon, "bbox": [0, 0, 95, 71]}
            for i, polygon in enumerate(corners)
        ]

    path = edit(root, change)
    back = LerfOvsDataset(root).load(SCENE)
    expected = langsplat_masks(path)
    view = back.truth.test_views[0]
    assert len(expected) == 7
    for name, mask in expected.items():
        assert np.array_equal(back.truth.mask(view, name), mask)
        count = sum(i % 7 == int(name[-1]) for i in range(40))
        assert back.truth.boxes[view.name, name] == ((0, 0, 95, 71),) * count


def test_categories_keep_their_case_and_ids_differ(root: Path) -> None:
    def change(content: dict) -> None:
        polygon, box = [[1, 1], [9, 1], [9, 9]], [1, 1, 9, 9]
        names = ["Stainless steel pots", "pour-over vessel", "Red cup", "red cup", "red  cup", "杯"]
        content["objects"] = [
            {"category": name, "segmentation": polygon, "bbox": box} for name in names
        ]

    edit(root, change)
    back = LerfOvsDataset(root).load(SCENE)
    assert [(q.id, q.text) for q in back.queries[:6]] == [
        ("stainless-steel-pots", "Stainless steel pots"),
        ("pour-over-vessel", "pour-over vessel"),
        ("red-cup", "Red cup"),
        ("red-cup-2", "red cup"),
        ("red-cup-3", "red  cup"),
        ("object", "杯"),
    ]
    assert any("differ only in case or spaces, kept apart: 2" in note for note in back.notes)


def test_predictions_are_scored_at_the_size_of_the_labels(root: Path) -> None:
    def change(content: dict) -> None:
        content["info"].update(width=192, height=144)

    path = edit(root, change)
    Image.new("RGB", (192, 144)).save(path.with_suffix(".jpg"))
    back = LerfOvsDataset(root).load(SCENE)
    labelled = back.truth.test_views[0].camera
    known = next(v for v in back.scene.views if v.name == FRAMES[0]).camera
    assert (labelled.width, labelled.height, known.width, known.height) == (192, 144, 96, 72)
    np.testing.assert_allclose(labelled.K[:2], 2 * known.K[:2])
    assert back.truth.mask(back.truth.test_views[0], "a red box").shape == (144, 192)
    assert any("scored at their masks' size: 1" in note for note in back.notes)


def test_pixels_that_are_not_square_stay_so(root: Path) -> None:
    model = root / SCENE / "sparse" / "0"
    cameras = read_colmap_model(model).cameras
    stretch = np.diag([1.0, 1.25, 1.0])
    write_colmap_text(model, [(n, replace(c, K=stretch @ c.K)) for n, c in cameras.items()])
    back = LerfOvsDataset(root).load(SCENE)
    for view in (*back.scene.views, *back.truth.test_views):
        K = view.camera.K
        assert K[1, 1] / K[0, 0] == pytest.approx(1.25)
        np.testing.assert_allclose(K, stretch @ cameras[f"{view.name}.jpg"].K)


def test_scenes_are_in_the_order_of_the_paper(root: Path) -> None:
    for name in ("waldo_kitchen", "figurines", "attic"):
        shutil.copytree(root / SCENE, root / name)
        shutil.copytree(root / "label" / SCENE, root / "label" / name)
    (root / "ramen").mkdir()
    (root / "bouquet").mkdir()
    data = LerfOvsDataset(root)
    assert data.scenes() == ("ramen", "figurines", "waldo_kitchen", "attic", SCENE)
    assert SCENES == ("ramen", "figurines", "teatime", "waldo_kitchen")
    with pytest.raises(DatasetError, match="label/ramen: missing folder"):
        data.load("ramen")
    with pytest.raises(ConfigError, match=r"'bouquet'.*attic, figurines"):
        data.load("bouquet")
    assert any("without labels, left out: 1 (bouquet)" in n for n in data.load("attic").notes)


def test_splats_may_lie_elsewhere(root: Path, tmp_path: Path) -> None:
    splats = tmp_path / "splats"
    splats.mkdir()
    shutil.move(root / SCENE / "point_cloud/iteration_30000/point_cloud.ply", splats / "x.ply")
    shutil.rmtree(root / SCENE / "point_cloud")
    with pytest.raises(DatasetError, match=SCENE):
        LerfOvsDataset(root).load(SCENE)
    with pytest.raises(DatasetError, match=r"two-boxes\.ply"):
        LerfOvsDataset(root, splats).load(SCENE)
    (splats / "x.ply").rename(splats / f"{SCENE}.ply")
    assert len(LerfOvsDataset(root, splats).load(SCENE).scene.gaussians) > 1000


def test_digests_tell_what_changed(root: Path) -> None:
    def read() -> dict[str, str]:
        return dict(LerfOvsDataset(root).load(SCENE).digests)

    first = read()
    assert set(first) == {"gaussians", "views", "queries", "truth"} and read() == first
    edit(root, lambda content: content["objects"][0].update(bbox=[0, 0, 95, 71]))
    second = read()
    assert {key for key in first if first[key] != second[key]} == {"truth"}
    edit(root, lambda content: content["objects"][0].update(category="cube"))
    third = read()
    assert {key for key in first if second[key] != third[key]} == {"queries", "truth"}
    Image.new("RGB", (96, 72)).save(root / SCENE / "images" / "frame_00001.jpg")
    fourth = read()
    assert {key for key in first if third[key] != fourth[key]} == {"views"}
