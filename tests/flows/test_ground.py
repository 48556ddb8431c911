"""``gvr ground``: what it writes, what it refuses, and the README's library use."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from small_queries import MEANINGS
from small_scene import OBJECTS, two_boxes
from splat_files import save_vertex, vertex_of

from datasets.inria_cameras import write_inria_cameras
from datasets.own import own_scene
from flows.own import OwnAnswer, ground_own
from gvr_core.errors import ConfigError, SplatFormatError
from gvr_core.methods import MethodConfig
from gvr_core.models.oracle import OracleWorld, oracle_models
from gvr_core.scene import Scene
from gvr_core.splat_io import read_ply, write_ply
from tasks.groundings import Answer

README = Path(__file__).resolve().parents[2] / "README.md"


@pytest.fixture
def boxes(tmp_path: Path) -> tuple[Path, Path]:
    """The small scene as a splat file, with an extra column, and its cameras."""
    scene, _ = two_boxes()
    splat, cameras = tmp_path / "boxes.ply", tmp_path / "cameras.json"
    write_ply(splat, scene.gaussians)
    plain = vertex_of(splat)
    vertex = np.empty(len(plain), [*plain.dtype.descr, ("label", "u1")])
    for name in plain.dtype.names:
        vertex[name] = plain[name]
    vertex["label"] = np.arange(len(vertex)) % 256
    save_vertex(splat, vertex)
    write_inria_cameras(cameras, [(view.name, view.camera) for view in scene.views])
    return splat, cameras


def ious(indices: NDArray[np.int64], label: int) -> float:
    _, labels = two_boxes()
    flags = np.zeros(len(labels), bool)
    flags[indices] = True
    truth = labels == label
    return (flags & truth).sum() / (flags | truth).sum()


def test_every_export_of_every_answer(gvr, home, tmp_path, boxes, oracles, prefect_server) -> None:
    splat, cameras = boxes
    out = tmp_path / "out"
    out.mkdir()
    (out / "q1.target.ply").write_bytes(b"of an earlier call")
    code, shown, err = gvr(
        *("ground", str(splat), "--cameras", str(cameras), "--query", "a red box"),
        *("--query", "an elephant [sic]", "--query", "a blue box", "--out", str(out), "--quiet"),
        *("--export", "target", "--export", "without", "--export", "dyed", "--dye", "#00ff00"),
    )
    assert code == 0, err
    three = ("indices.npy", "png", "dyed.ply", "target.ply", "without.ply")
    names = [f"{query}.{ending}" for query in ("q0", "q2") for ending in three]
    names += ["q1.indices.npy", "q1.png", "answers.json"]
    assert sorted(path.name for path in out.iterdir()) == sorted(names)
    assert "an elephant [sic]: nothing was found" in shown
    assert "no PLY for: target, without, dyed" in shown

    vertex = vertex_of(splat)
    for query, label in (("q0", 0), ("q2", 1)):
        indices = np.load(out / f"{query}.indices.npy", allow_pickle=False)
        assert indices.dtype == np.int64
        assert (np.diff(indices) > 0).all()
        assert ious(indices, label) >= 0.75
        rest = np.setdiff1d(np.arange(len(vertex)), indices)
        np.testing.assert_array_equal(vertex_of(out / f"{query}.target.ply"), vertex[indices])
        np.testing.assert_array_equal(vertex_of(out / f"{query}.without.ply"), vertex[rest])
        dyed = vertex_of(out / f"{query}.dyed.ply")
        np.testing.assert_array_equal(dyed[rest], vertex[rest])
        colours = 0.5 + 0.28209479177387814 * read_ply(out / f"{query}.dyed.ply").sh[indices, 0]
        np.testing.assert_allclose(colours, np.tile([0, 1, 0], (len(indices), 1)), atol=1e-6)
        assert (out / f"{query}.png").read_bytes().startswith(b"\x89PNG")
    assert np.load(out / "q1.indices.npy", allow_pickle=False).shape == (0,)

    summary = json.loads((out / "answers.json").read_text(encoding="utf-8"))
    assert summary["splat"] == "boxes.ply"
    assert summary["n_gaussians"] == len(vertex)
    red, elephant, blue = summary["answers"]
    assert [red["text"], red["found"], elephant["found"], blue["id"]] == [
        *("a red box", True, False, "q2")
    ]
    np.testing.assert_allclose(red["location"], [-1, 0, 0.45], atol=0.5)
    assert red["count"] == len(vertex_of(out / red["files"]["target"]))
    assert elephant["files"] == {"indices": "q1.indices.npy", "picture": "q1.png"}
    assert all((out / name).exists() for answer in (red, blue) for name in answer["files"].values())


def test_only_the_target_unless_told_otherwise(
    gvr, home, tmp_path, boxes, oracles, prefect_server
) -> None:
    splat, cameras = boxes
    arguments = ("ground", str(splat), "--cameras", str(cameras), "--query", "a red box", "-q")
    code, _, err = gvr(*arguments, "--out", str(tmp_path / "a"))
    assert code == 0, err
    assert {path.name for path in (tmp_path / "a").iterdir()} == {
        *("q0.target.ply", "q0.indices.npy", "q0.png", "answers.json")
    }
    code, _, err = gvr(*arguments, "--out", str(tmp_path / "b"), "--export", "without")
    assert code == 0, err
    target, rest = vertex_of(tmp_path / "a/q0.target.ply"), vertex_of(tmp_path / "b/q0.without.ply")
    assert len(target) + len(rest) == len(vertex_of(splat))
    assert not (tmp_path / "b" / "q0.target.ply").exists()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"--cameras": "none.json"}, "none.json"),
        ({"--method": "gvr"}, "gvr-paper"),
        ({"--query": " "}, "1 to 400"),
        ({"--max-views": "0"}, "1 or more"),
        ({"--export": "mask"}, "unknown export 'mask' (accepted: dyed, target, without)"),
        ({"--export": "dyed", "--dye": "red"}, "'red' (accepted: six hexadecimal digits"),
        ({"--dye": "#ff0000"}, "--export dyed"),
        ({"--out": "boxes.ply"}, "is no folder"),
        ({"--out": "boxes.ply/sub"}, "is no folder"),
    ],
    ids=str,
)
def test_what_cannot_be_used_is_refused_before_anything_is_computed(
    gvr, home, tmp_path, boxes, oracles, prefect_server, change, expected, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    splat, cameras = boxes
    options = {"--cameras": str(cameras), "--query": "a red box", "--out": "out"} | change
    before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    code, _, err = gvr("ground", str(splat), *(part for pair in options.items() for part in pair))
    assert code == 2
    assert expected in err.replace("\n", "")
    assert "Traceback" not in err
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == before


def test_an_export_never_replaces_the_scene(gvr, home, tmp_path, boxes, oracles) -> None:
    splat, cameras = boxes
    splat = splat.rename(tmp_path / "q0.target.ply")
    before = splat.read_bytes()
    code, _, err = gvr(
        *("ground", str(splat), "--cameras", str(cameras), "--query", "a red box"),
        *("--out", str(tmp_path)),
    )
    assert code == 2
    assert "the scene itself would be replaced" in err
    assert splat.read_bytes() == before


@pytest.fixture
def answered(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, boxes):
    """Ground with a given answer in the place of the method's; returns what came out."""
    splat, cameras = boxes
    picture = tmp_path / "picture.png"
    picture.write_bytes(b"picture")

    def ground(flags: NDArray[np.bool_], *kinds: str, meanwhile=lambda: None) -> list[OwnAnswer]:
        data = own_scene(splat, cameras, ["a thing"])
        answer = Answer(flags, flags.astype(np.float32), np.zeros(3), True, 0.5)

        def unpack(arrays: object) -> list[Answer]:
            meanwhile()
            return [answer]

        held = SimpleNamespace(path=lambda artifact: picture, load_arrays=lambda artifact: {})
        job = SimpleNamespace(
            data=data,
            queries=data.queries,
            store=held,
            method=MethodConfig(),
            model_names=lambda: {"encoder": "none, for the answer is given"},
        )
        runs = {"segment": {"groundings": None}, "evaluate": {"picture.q0": None}}
        monkeypatch.setattr("flows.own.make_job", lambda *_, **__: job)
        monkeypatch.setattr("flows.own.run_stages", lambda job: runs)
        monkeypatch.setattr("flows.own.unpack_answers", unpack)
        return ground_own.fn(data, splat, "gvr-paper", tmp_path / "out", tmp_path, kinds)

    return ground


def test_a_target_that_is_the_whole_scene_leaves_no_scene_without_it(answered, boxes) -> None:
    everything = np.ones(len(vertex_of(boxes[0])), bool)
    (answer,) = answered(everything, "target", "without")
    assert set(answer.files) == {"indices", "picture", "target"}
    assert answer.count == len(everything)


def test_a_target_without_gaussians_gets_no_ply(answered, boxes, tmp_path) -> None:
    (answer,) = answered(np.zeros(len(vertex_of(boxes[0])), bool), "target", "dyed")
    assert set(answer.files) == {"indices", "picture"}
    assert not list((tmp_path / "out").glob("*.ply"))


def test_a_scene_that_changed_meanwhile_is_not_exported_from(answered, boxes, tmp_path) -> None:
    vertex = vertex_of(boxes[0])

    def change() -> None:
        save_vertex(boxes[0], vertex[::-1].copy())

    with pytest.raises(SplatFormatError, match="changed while"):
        answered(np.arange(len(vertex)) < 5, "target", meanwhile=change)
    assert not (tmp_path / "out").exists()


def test_a_folder_that_becomes_unwritable_is_named(answered, boxes, tmp_path) -> None:
    flags = np.arange(len(vertex_of(boxes[0]))) < 5
    with pytest.raises(ConfigError, match=r"out: the answers cannot be written: .+"):
        answered(flags, "target", meanwhile=(tmp_path / "out").touch)
    assert (tmp_path / "out").read_bytes() == b""


def write_colmap(folder: Path, scene: Scene) -> None:
    """The scene's cameras as a COLMAP model in text."""
    folder.mkdir(parents=True)
    cameras, images = [], []
    for i, view in enumerate(scene.views, start=1):
        K, pose = view.camera.K, view.camera.world_to_camera
        numbers = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
        size = [view.camera.width, view.camera.height]
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        cameras.append(" ".join(map(str, [i, "PINHOLE", *size, *numbers])))
        images.append(" ".join(map(str, [i, w, x, y, z, *pose[:3, 3], i, f"{view.name}.png"])))
    (folder / "cameras.txt").write_text("\n".join(cameras) + "\n")
    (folder / "images.txt").write_text("\n\n".join(images) + "\n\n")
    (folder / "points3D.txt").write_text("")


def test_the_readmes_library_use_runs_as_it_stands(tmp_path, monkeypatch) -> None:
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    (snippet,) = [block for block in blocks if "own_scene" in block]
    assert len([line for line in snippet.splitlines() if line.strip()]) < 10
    scene, labels = two_boxes()
    world = OracleWorld(scene.gaussians, labels, OBJECTS, MEANINGS | {"a red mug": OBJECTS[0]})
    monkeypatch.setattr("gvr_core.models.registry.build_models", lambda: oracle_models(world))
    monkeypatch.chdir(tmp_path)
    write_ply("scene.ply", scene.gaussians)
    write_colmap(tmp_path / "sparse" / "0", scene)
    names: dict[str, object] = {}
    exec(compile(snippet, "README.md", "exec"), names)
    flags = names["grounding"].flags
    assert ious(np.flatnonzero(flags), 0) >= 0.75
    np.testing.assert_array_equal(vertex_of(Path("mug.ply")), vertex_of(Path("scene.ply"))[flags])
