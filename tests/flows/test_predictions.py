"""Somebody else's predictions through the same evaluator, and results scored again."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from datasets.images import write_png
from datasets.native import read_scene
from reports.record import Result, Row
from reports.result_io import read_result

IN_SCENE = "gvr.in_scene_2d/1"
Gvr = Callable[..., tuple[int, str, str]]


@pytest.fixture
def data(two_boxes_folder: Path):
    return read_scene(two_boxes_folder / "two-boxes")


@pytest.fixture
def masks(data, tmp_path: Path) -> Path:
    """The truth as predictions: a perfect method, but for the wording 'the crimson cube'."""
    root = tmp_path / "masks"
    for view in data.truth.test_views:
        for query in data.queries:
            if query.target and query.text != "the crimson cube":
                path = root / "two-boxes" / view.name / f"{query.text}.png"
                path.parent.mkdir(parents=True, exist_ok=True)
                write_png(path, data.truth.mask(view, query.target))
    return root


def suite(path: Path, data: Path, predictions: Path, more: str = "") -> str:
    path.write_text(
        f"""
name = "given"
{more}
[[datasets]]
name = "folder:{data}"
[[methods]]
method = "predictions"
label = "theirs"
predictions = {{ folder = "{predictions}" }}
"""
    )
    return str(path)


def run(gvr: Gvr, home: Path, *arguments: str) -> tuple[Result, tuple[Row, ...]]:
    code, _, error = gvr("run", *arguments, "--quiet", "--no-mlflow")
    assert code == 0, error
    return newest(home)


def newest(home: Path) -> tuple[Result, tuple[Row, ...]]:
    return read_result(max((home / "results").iterdir(), key=lambda path: path.stat().st_mtime_ns))


def test_masks_are_scored_like_any_method(
    gvr, home, tmp_path, two_boxes_folder, masks, prefect_server
) -> None:
    path = suite(tmp_path / "given.toml", two_boxes_folder, masks)
    result, rows = run(gvr, home, path)
    (scene,) = result.scenes
    assert scene.status == "completed", scene.error
    assert [timing.stage for timing in scene.stages] == ["query", "segment", "evaluate"]
    for row in rows:
        if row.protocol == IN_SCENE and row.text == "the crimson cube":
            assert row.metrics["iou"] == 0 and row.metrics["acc_peak"] == 0, "missing counts as 0"
        elif row.protocol == IN_SCENE:
            assert row.metrics["iou"] == 1 and row.metrics["acc_peak"] == 1
    found = {row.text: row.metrics["found"] for row in rows if row.protocol == "refusal/1"}
    assert found == {"a red box": 1, "a blue box": 1}, "who has not answered has not refused"
    assert result.scenes[0].models == {"renderer": result.scenes[0].models["renderer"]}
    labelled = sum(row.protocol == IN_SCENE for row in rows)
    assert labelled == 6
    assert not any(row.protocol == "flags_3d/1" for row in rows), "pictures flag no Gaussians"

    changed = masks / "two-boxes" / "v01" / "a red box.png"
    write_png(changed, np.zeros((72, 96), np.bool_))
    _, rows = run(gvr, home, path)
    views = {r.view: r.metrics["iou"] for r in rows if r.text == "a red box" and r.view}
    assert views == {"v01": 0, "v05": 1}


def test_flags_are_scored_in_3d_too(
    gvr, home, tmp_path, two_boxes_folder, data, prefect_server
) -> None:
    folder = tmp_path / "flags" / "two-boxes" / "flags"
    folder.mkdir(parents=True)
    red = data.truth.flags("red box")
    np.save(folder / "a red box.npy", red)
    np.save(folder / "the crimson cube.npy", np.flatnonzero(red))
    path = suite(tmp_path / "given.toml", two_boxes_folder, tmp_path / "flags")
    _, rows = run(gvr, home, path)
    iou = {row.query: row.metrics["iou"] for row in rows if row.protocol == "flags_3d/1"}
    assert iou == {"red-1": 1, "red-2": 1, "blue-1": 0}
    refused = [row.query for row in rows if row.protocol == "refusal/1"]
    assert refused == ["red-1", "red-2"], "who has not answered has not refused"
    drawn = [r.metrics["iou"] for r in rows if r.protocol == IN_SCENE and r.query == "red-1"]
    assert len(drawn) == 2 and min(drawn) > 0.9


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda root: shutil.rmtree(root / "two-boxes"), "no predictions for the scene"),
        (lambda root: (root / "two-boxes" / "flags").mkdir(), "not both"),
        (
            lambda root: (root / "two-boxes" / "v01" / "a red box.png").write_bytes(b"no picture"),
            "cannot be decoded",
        ),
        (
            lambda root: write_png(
                root / "two-boxes" / "v01" / "a red box.png", np.ones((9, 9), np.bool_)
            ),
            "9 x 9 pixels",
        ),
        (
            lambda root: np.save(
                root / "two-boxes" / "v01" / "a red box.npy", np.zeros((72, 96), np.float32)
            ),
            "both answer",
        ),
        (
            lambda root: (root / "two-boxes" / "v01").rename(root / "two-boxes" / "v00"),
            "predictions for v00",
        ),
        (
            lambda root: write_png(
                root / "two-boxes" / "v01" / "a red box.png", np.ones((72, 96), np.uint8)
            ),
            "all pixels are 0 or 1",
        ),
        (
            lambda root: Image.new("P", (96, 72)).save(
                root / "two-boxes" / "v01" / "a red box.png"
            ),
            "no palette",
        ),
        (
            lambda root: np.save(
                root / "two-boxes" / "v01" / "the crimson cube.npy",
                np.full((2, 72, 96), 1.5, np.float32),
            ),
            "from 0 to 1",
        ),
        (
            lambda root: np.save(
                root / "two-boxes" / "v01" / "the crimson cube.npy",
                np.array([{"a": 1}], dtype=object),
                allow_pickle=True,
            ),
            "a .npy file of numbers",
        ),
    ],
)
def test_bad_predictions_are_told(
    gvr, home, tmp_path, two_boxes_folder, masks, prefect_server, spoil, said
) -> None:
    spoil(masks)
    path = suite(tmp_path / "given.toml", two_boxes_folder, masks)
    code, _, error = gvr("run", path, "--quiet", "--no-mlflow")
    assert code == 2 and said in error


@pytest.mark.parametrize(
    "flags",
    [np.ones(5, np.bool_), np.ones(9088, np.int64), np.array([0, 1, 1]), np.array([-1]), "text"],
)
def test_flags_that_are_none_are_told(
    gvr, home, tmp_path, two_boxes_folder, data, prefect_server, flags
) -> None:
    folder = tmp_path / "flags" / "two-boxes" / "flags"
    folder.mkdir(parents=True)
    assert len(data.scene.gaussians) == 9088
    np.save(folder / "a red box.npy", np.asarray(flags))
    path = suite(tmp_path / "given.toml", two_boxes_folder, tmp_path / "flags")
    code, _, error = gvr("run", path, "--quiet", "--no-mlflow")
    assert code == 2 and "9087, each once" in error


def test_links_are_followed_and_seen(
    gvr, home, tmp_path, two_boxes_folder, masks, prefect_server
) -> None:
    linked = tmp_path / "linked"
    linked.mkdir()
    (linked / "two-boxes").symlink_to(masks / "two-boxes")
    path = suite(tmp_path / "given.toml", two_boxes_folder, linked)
    run(gvr, home, path)
    write_png(masks / "two-boxes" / "v01" / "a red box.png", np.zeros((72, 96), np.bool_))
    _, rows = run(gvr, home, path)
    views = {r.view: r.metrics["iou"] for r in rows if r.text == "a red box" and r.view}
    assert views == {"v01": 0, "v05": 1}


def test_predictions_need_no_weights(
    gvr, home, tmp_path, two_boxes_folder, masks, prefect_server, monkeypatch
) -> None:
    monkeypatch.setenv("GVR_MODELS", str(tmp_path / "empty"))
    path = suite(tmp_path / "given.toml", two_boxes_folder, masks)
    result, _ = run(gvr, home, path, "--models", "paper", "--models", "onboard")
    assert [scene.method for scene in result.scenes] == ["theirs"], "one line for all models"


def test_a_result_is_scored_again_without_grounding(
    gvr, home, tmp_path, two_boxes_folder, prefect_server
) -> None:
    path = tmp_path / "oracle.toml"
    path.write_text(
        f"""
name = "oracle"
[[datasets]]
name = "folder:{two_boxes_folder}/"
[[methods]]
method = "gvr-paper"
[models]
segmenter = "oracle"
encoder = "oracle"
text_segmenter = "oracle"
"""
    )
    first, rows = run(gvr, home, str(path))
    known = "lerf_ovs.opengaussian_3d/1"
    arguments = ("--protocol", IN_SCENE, "--protocol", known, "--protocol", known[:-2])
    code, _, error = gvr("score", first.run_id, *arguments)
    assert code == 0, error
    again, scored = newest(home)
    assert again.config["scored_from"] == first.run_id and again.run_id != first.run_id
    assert [r for r in scored if r.protocol == IN_SCENE] == [
        r for r in rows if r.protocol == IN_SCENE
    ]
    ours = [r.metrics["iou"] for r in scored if r.protocol == known]
    assert len(ours) == 6 and min(ours) > 0.7
    code, _, error = gvr("score", first.run_id, "--protocol", "nobody.knows/1")
    assert code == 2 and known in error
    for record in (home / "store" / "records" / "segment").iterdir():
        record.unlink()
    code, _, error = gvr("score", first.run_id, *arguments)
    assert code == 2 and "not in the store" in error


def test_test_views_can_be_kept_out_of_the_books(
    gvr, home, tmp_path, two_boxes_folder, data, prefect_server
) -> None:
    """A native scene holds its test views out already, so nothing changes there."""
    path = tmp_path / "random.toml"
    path.write_text(
        f"""
name = "random"
limit = 1
[[datasets]]
name = "folder:{two_boxes_folder}"
[[methods]]
method = "random-patch"
"""
    )
    with_views, _ = run(gvr, home, str(path))
    without, _ = run(gvr, home, str(path), "--exclude-eval-views")
    assert without.config["exclude_eval_views"] is True
    assert without.scenes[0].n_views == with_views.scenes[0].n_views == len(data.scene.views)
    assert {t.state for t in without.scenes[0].stages} == {"cached"}
