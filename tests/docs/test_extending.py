"""The page on bringing one's own parts: its examples, run as they stand there."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from docs_pages import blocks
from fresh_folder import REPOSITORY, environment, shell
from small_scene import two_boxes

from datasets.colmap import write_colmap_text
from datasets.inria_cameras import write_inria_cameras
from gvr_core.splat_io import write_ply

PAGE = "extending.md"
MOST_LINES = 60
"""Of an example, without the empty ones."""


@pytest.fixture(scope="module")
def captured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a reader has: a splat with its cameras in two formats, and labels."""
    folder = tmp_path_factory.mktemp("captured")
    scene, labels = two_boxes()
    named = [(f"{view.name}.png", view.camera) for view in scene.views]
    write_ply(folder / "scene.ply", scene.gaussians)
    write_inria_cameras(folder / "cameras.json", named)
    (folder / "sparse").mkdir()
    write_colmap_text(folder / "sparse" / "0", named, scene.gaussians.means[:4], np.zeros((4, 3)))
    np.save(folder / "labels.npy", labels)
    return folder


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page's package, built and installed by pip into a folder of its own."""
    source, target = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("installed")
    (source / "my_parts").mkdir()
    (source / "my_parts" / "__init__.py").touch()
    (source / "pyproject.toml").write_text(blocks(PAGE, "toml")["pyproject.toml"])
    for name, text in blocks(PAGE, "python").items():
        if name.startswith("my_parts/"):
            (source / name).write_text(text)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps"]
    options = ["--no-build-isolation", "--disable-pip-version-check", "--target", str(target)]
    subprocess.run([*pip, *options, str(source)], check=True, env=environment(), timeout=300)
    return target


def newest(folder: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The newest result below a folder, and its rows."""
    result = sorted((folder / ".gvr" / "results").iterdir())[-1]
    rows = (result / "rows.jsonl").read_text().splitlines()
    return json.loads((result / "result.json").read_text()), [json.loads(row) for row in rows]


def ious(rows: list[dict[str, Any]], method: str) -> dict[str, float]:
    """Text -> 3D IoU of a method's answers."""
    chosen = [row for row in rows if row["method"] == method and row["protocol"] == "flags_3d/1"]
    return {row["text"]: row["metrics"]["iou"] for row in chosen}


def test_examples_are_short_and_in_the_style_of_the_project(tmp_path: Path) -> None:
    examples = blocks(PAGE, "python")
    for name, text in examples.items():
        assert len([line for line in text.splitlines() if line]) < MOST_LINES, name
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    config = ["--config", str(REPOSITORY / "pyproject.toml")]
    ruff = [sys.executable, "-m", "ruff"]
    subprocess.run([*ruff, "check", *config, "--ignore", "D", str(tmp_path)], check=True)
    subprocess.run([*ruff, "format", "--check", *config, str(tmp_path)], check=True)


@pytest.mark.slow
def test_a_splat_with_cameras_can_be_asked(captured: Path, tmp_path: Path) -> None:
    for name in ("scene.ply", "sparse"):
        source = captured / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, tmp_path / name)
    shell(blocks(PAGE, "sh")["ground"], tmp_path)
    answers = json.loads((tmp_path / "found" / "answers.json").read_text())
    (answer,) = answers["answers"]
    assert answer["text"] == "a red box"


@pytest.mark.slow
def test_a_labelled_scene_is_written_and_run(captured: Path, tmp_path: Path) -> None:
    shutil.copytree(captured, tmp_path, dirs_exist_ok=True)
    (tmp_path / "write_scene.py").write_text(blocks(PAGE, "python")["write_scene.py"])
    (tmp_path / "own.toml").write_text(blocks(PAGE, "toml")["own.toml"])
    shell(blocks(PAGE, "sh")["own"], tmp_path)
    result, rows = newest(tmp_path)
    assert [scene["status"] for scene in result["scenes"]] == ["completed"]
    found = ious(rows, "gvr-paper")
    assert set(found) == {"a red box", "a blue box"}
    assert min(found.values()) > 0.8


@pytest.mark.slow
def test_a_package_of_plugins_is_installed_and_run(
    captured: Path, installed: Path, tmp_path: Path
) -> None:
    desk = tmp_path / "shelves" / "desk"
    desk.mkdir(parents=True)
    for name in ("scene.ply", "cameras.json", "labels.npy"):
        shutil.copy(captured / name, desk / name)
    # Labels count the sorted names; in the file, red was 0 and blue 1.
    labels = np.load(desk / "labels.npy")
    np.save(desk / "labels.npy", np.array([1, 0, -1], np.int16)[labels])
    (desk / "queries.json").write_text(json.dumps({"a red box": "red", "a blue box": "blue"}))
    (tmp_path / "mine.toml").write_text(blocks(PAGE, "toml")["mine.toml"])

    shell(blocks(PAGE, "sh")["mine"], tmp_path, [installed])
    result, rows = newest(tmp_path)
    assert [scene["status"] for scene in result["scenes"]] == ["completed"] * 2
    assert result["environment"]["packages"]["my-parts"] == "0.1"
    # One view sees no more than the front of a box, and nothing of its inside.
    for method, least in (("one-patch", 0.3), ("gvr-paper", 0.8)):
        found = ious(rows, method)
        assert set(found) == {"a red box", "a blue box"}
        assert min(found.values()) > least, (method, found)

    # Processes and Dask workers find the plugins, and give them the same keys.
    for runner in ("processes", "dask"):
        shell(f"gvr run mine.toml --runner {runner} --workers 2 --no-mlflow", tmp_path, [installed])
        result, again = newest(tmp_path)
        states = {stage["state"] for scene in result["scenes"] for stage in scene["stages"]}
        assert states == {"cached"}
        assert again == rows

    listed = shell("gvr doctor || true", tmp_path, [installed])
    for name in ("shelves", "flat-regions", "colours", "colour-boxes", "one-patch"):
        assert f"{name} (my-parts 0.1)" in " ".join(listed.split())
