"""``gvr init``: a suite for scenes of one's own, which ``gvr run`` takes as it is."""

from __future__ import annotations

import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from small_captures import some_views, stems, write_capture
from transforms_files import instant_ngp, nerfstudio

from datasets.inria_cameras import write_inria_cameras
from datasets.native import read_scene
from flows.datasets_commands import EXPORTS
from flows.own_suite import suite_name
from flows.view_session import open_scene
from gvr_core.rendering import get_renderer


@pytest.fixture
def mine(tmp_path: Path, two_boxes_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A labelled scene, two captures of which one has no splat, and a folder of notes."""
    folder = tmp_path / "my scenes"
    shutil.copytree(two_boxes_folder / "two-boxes", folder / "two-boxes")
    write_capture(folder / "ramen")
    write_capture(folder / "egg")
    shutil.rmtree(folder / "egg" / "point_cloud")
    (folder / "notes").mkdir()
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    return folder


def test_init_and_then_run(gvr, home, mine: Path, prefect_server) -> None:
    code, out, err = gvr("init", str(mine), "--query", "a box", "--method", "gvr-paper")
    assert (code, err) == (0, "")
    assert "native  two-boxes: " in out and "4 queries" in out
    assert "capture  ramen: 182 Gaussians, 4 views, no labels" in out
    assert "left out  egg: " in out and "no trained splat" in out
    assert out.splitlines()[-1] == "Next: gvr run my-scenes.toml"
    code, out, err = gvr("run", "my-scenes.toml", "--quiet", "--no-mlflow", "--json")
    assert code == 0, err
    scenes = {scene["scene"]: scene for scene in json.loads(out)["scenes"]}
    assert {name: scene["status"] for name, scene in scenes.items()} == {
        "two-boxes": "completed",
        "ramen": "completed",
    }
    (answer,) = scenes["ramen"]["answers"]
    assert answer["text"] == "a box"
    folder = Path(json.loads(out)["result"])
    assert (folder / answer["picture"]).is_file()
    code, out, err = gvr("report", "--out", "report.html")
    assert code == 0, err
    assert "a box" in Path("report.html").read_text()
    code, out, _ = gvr("show", folder.name)
    assert code == 0
    assert f"captures:{mine}: what was answered" in " ".join(out.split())


def test_a_capture_with_masks_is_scored_the_next_time(gvr, home, mine: Path) -> None:
    shutil.rmtree(mine / "two-boxes")
    # A scene that papers report is none of LERF-Mask's here, as it has no masks.
    shutil.copytree(mine / "ramen", mine / "figurines")
    scene = mine / "ramen"
    pictures = sorted((scene / "images").iterdir())
    (scene / "images_train").mkdir()
    for path in pictures[1:]:
        (scene / "images_train" / path.name).touch()
    with Image.open(pictures[0]) as picture:
        mask = np.zeros(picture.size[::-1], np.uint8)
    mask[5:20, 5:20] = 255
    (scene / "test_mask" / "0").mkdir(parents=True)
    Image.fromarray(mask).save(scene / "test_mask" / "0" / "red box.png")
    code, out, err = gvr("init", str(mine), "--json", "--out", "masks.toml")
    assert (code, err) == (0, "")
    found = {data["layout"]: data for data in json.loads(out)["found"]}
    assert [s["name"] for s in found["lerf_mask"]["scenes"]] == ["ramen"]
    assert [s["name"] for s in found["capture"]["left_out"]] == ["egg"]
    assert [s["name"] for s in found["capture"]["scenes"]] == ["figurines"]
    masks, captures = tomllib.loads(Path("masks.toml").read_text())["datasets"]
    assert masks == {"name": "lerf_mask", "scenes": ["ramen"], "settings": {"root": str(mine)}}
    assert list(captures["settings"]["queries"]) == ["figurines"]
    code, out, err = gvr("run", "masks.toml", "--dry-run", "--json")
    assert code == 0, err


def as_inria(scene: Path) -> None:
    write_inria_cameras(scene / "cameras.json", stems(some_views()))
    shutil.rmtree(scene / "images")  # an output folder of the training has none


def as_nerfstudio(scene: Path) -> None:
    (scene / "transforms.json").write_text(json.dumps(nerfstudio(some_views())))


def as_instant_ngp(scene: Path) -> None:
    (scene / "transforms.json").write_text(json.dumps(instant_ngp(some_views())))


@pytest.mark.parametrize("cameras", [as_inria, as_nerfstudio, as_instant_ngp])
def test_captures_of_every_kind_of_cameras(gvr, home, mine: Path, cameras) -> None:
    scene = mine / "ramen"
    shutil.rmtree(scene / "sparse")
    cameras(scene)
    code, out, err = gvr("init", str(scene), "--query", "a box", "--json")
    assert (code, err) == (0, "")
    (data,) = json.loads(out)["found"]
    assert (data["layout"], data["scenes"][0]["n_views"]) == ("capture", 4)
    code, _, err = gvr("run", "ramen.toml", "--dry-run")
    assert code == 0, err


@pytest.mark.parametrize("layout", EXPORTS)
def test_benchmarks_in_their_layouts(gvr, home, mine: Path, layout: str) -> None:
    root = mine.parent / "tree"
    EXPORTS[layout](read_scene(mine / "two-boxes"), root, get_renderer("numba"))
    code, out, err = gvr("init", str(root), "--json")
    assert (code, err) == (0, "")
    (data,) = json.loads(out)["found"]
    assert (data["layout"], [scene["name"] for scene in data["scenes"]]) == (layout, ["two-boxes"])
    assert data["scenes"][0]["n_queries"] > 0
    code, _, err = gvr("run", "tree.toml", "--dry-run")
    assert code == 0, err


def test_the_file_is_there_for_editing(gvr, home, mine: Path) -> None:
    code, out, _ = gvr("init", str(mine / "ramen"))
    assert code == 0
    assert out.splitlines()[-1] == (
        "Next: put your own queries into ramen.toml, then: gvr run ramen.toml"
    )
    text = Path("ramen.toml").read_text()
    assert '"ramen" = ["a chair", "a plant"]' in text
    for word in ("none is scored", "lerf_mask", "gvr-paper", "gvr models ls"):
        assert word in text
    assert tomllib.loads(text)["datasets"][0]["name"] == f"captures:{mine / 'ramen'}"


def test_a_query_that_nobody_is_asked_is_said(gvr, home, mine: Path) -> None:
    code, _, err = gvr("init", str(mine / "two-boxes"), "--query", "a box")
    assert code == 0
    assert "--query asks captures, and there are none" in err


def test_nothing_is_overwritten_unless_told(gvr, home, mine: Path) -> None:
    Path("ramen.toml").write_text("mine\n")
    code, out, err = gvr("init", str(mine / "ramen"))
    assert (code, out) == (2, "")
    assert "ramen.toml: there is a file already (accepted: --out FILE, or --force)" in err
    assert Path("ramen.toml").read_text() == "mine\n"
    assert gvr("init", str(mine / "ramen"), "--force")[0] == 0
    assert "captures:" in Path("ramen.toml").read_text()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("none",), "no such folder"),
        (("notes",), "looks like no data set"),
        (("egg",), "none of its scenes can be run: egg: "),
        (("ramen", "--method", "gvr-robst"), "did you mean 'gvr-robust'"),
        (("ramen", "--method", "predictions"), "unknown method 'predictions'"),
        (("ramen", "--models", "oracle"), "need the truth, which ramen does not state"),
        (("ramen", "--models", "onbord"), "did you mean 'onboard'"),
        (("ramen", "--query", " "), "1 to 400 characters"),
        (("ramen", "--out", "/proc/none/x.toml"), "cannot be written"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(
    gvr, home, mine: Path, arguments: tuple[str, ...], expected: str
) -> None:
    code, out, err = gvr("init", str(mine / arguments[0]), *arguments[1:])
    assert (code, out) == (2, "")
    assert expected in err and len(err.splitlines()) == 1
    assert not list(Path().glob("*.toml"))


@pytest.mark.parametrize(
    ("folder", "expected"),
    [("scans", "scans"), ("my scenes!", "my-scenes"), ("сцены", "mine"), ("-x-", "x")],
)
def test_a_suite_is_called_as_its_folder(tmp_path: Path, folder: str, expected: str) -> None:
    assert suite_name(tmp_path / folder) == expected


def test_names_with_quotes_and_line_breaks_stay_what_they_are(gvr, home, mine: Path) -> None:
    odd = mine.parent / 'a "b"\n[x]'
    shutil.copytree(mine / "ramen", odd / "egg's = [1]")
    code, _, err = gvr("init", str(odd), "--out", "odd.toml")
    assert code == 0, err
    (choice,) = tomllib.loads(Path("odd.toml").read_text())["datasets"]
    assert choice["name"] == f"captures:{odd}"
    assert list(choice["settings"]["queries"]) == ["egg's = [1]"]


def test_captures_can_be_looked_at(mine: Path) -> None:
    data = open_scene(f"captures:{mine}/ramen", None, None)
    assert (data.scene.name, len(data.scene.views), data.queries) == ("ramen", 4, ())
