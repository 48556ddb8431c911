from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from datasets.composite import LAYOUTS
from datasets.layout import ObjectTable, OrbitTable, read_layout
from gvr_core.errors import DatasetError

BUNDLED = sorted(LAYOUTS.glob("*.toml"))


def table(**changes: object) -> ObjectTable:
    given = {
        "name": "thing",
        "file": "thing.ply",
        "up": (0, -1, 0),
        "front": (1, 0, 0),
        "position": (0, 0),
        "height": 1,
        "queries": ("a thing", "some thing"),
    }
    return ObjectTable.model_validate({**given, **changes})


@pytest.mark.parametrize("yaw, front", [(0, (0, -1, 0)), (90, (1, 0, 0)), (-90, (-1, 0, 0))])
def test_upright_puts_up_and_front_where_they_belong(yaw: float, front: tuple[int, ...]) -> None:
    item = table(up=(0, -2, 0), front=(3, -0.4, 0), yaw=yaw)
    rotation = item.upright()
    np.testing.assert_allclose(rotation @ (0, -1, 0), (0, 0, 1), atol=1e-12)
    np.testing.assert_allclose(rotation @ (1, 0, 0), front, atol=1e-12)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_orbits_step_evenly_and_spread_their_pitch() -> None:
    orbit = OrbitTable.model_validate(
        {"count": 8, "radius": 2, "yaw": [10, 370], "pitch": [20, 40]}
    )
    yaws, pitches = np.array(orbit.poses()).T
    np.testing.assert_allclose(yaws, 10 + 45 * np.arange(8))
    assert pitches.min() >= 20 and pitches.max() <= 40 and np.ptp(pitches) > 12


@pytest.mark.parametrize("path", BUNDLED, ids=lambda path: path.stem)
def test_bundled_layouts_are_valid(path: Path) -> None:
    layout = read_layout(path)
    cameras = layout.cameras.cameras()
    knowledge = [camera for name, camera in cameras.items() if name.startswith("view_")]
    tests = [camera for name, camera in cameras.items() if name.startswith("test_")]
    assert len(knowledge) == 24 and len(tests) == 4 and len(cameras) == 28
    assert 3 <= len(layout.objects) <= 4 and layout.absent
    assert {(camera.width, camera.height) for camera in cameras.values()} == {(480, 360)}
    target = np.asarray(layout.cameras.target)
    for test in tests:
        away = [
            np.degrees(np.arccos(np.clip(test.forward @ camera.forward, -1, 1)))
            for camera in knowledge
        ]
        assert min(away) > 4
        pixel, _ = test.project(target)
        np.testing.assert_allclose(pixel, (240, 180), atol=1e-6)


def test_bundled_layouts_differ() -> None:
    layouts = [read_layout(path) for path in BUNDLED]
    assert [path.stem for path in BUNDLED] == ["apart", "crowded", "open"]
    places = [{item.name: (item.position, item.height) for item in x.objects} for x in layouts]
    for i, one in enumerate(places):
        for other in places[:i]:
            assert all(one[name] != other[name] for name in one.keys() & other.keys())


@pytest.mark.parametrize(
    "old, new, words",
    [
        ("[ground]", "[grund]", "grund: an unknown key"),
        ("height = 1.15", "hight = 1.15", "objects[0].hight: an unknown key"),
        ("height = 1.15", "height = 1.15\nhight = 2", "objects[0].hight: an unknown key"),
        ("height = 1.15", "height = 0", "objects[0].height"),
        ("height = 1.15", "height = nan", "objects[0].height"),
        ("height = 1.15", "height = ", "line 15"),
        ('file = "guitar.ply"', 'file = "../guitar.ply"', "objects[0].file"),
        ('file = "guitar.ply"', 'file = "guitar.obj"', "objects[0].file"),
        ('name = "guitar"', 'name = "gui/tar"', "objects[0].name: the object name 'gui/tar'"),
        ('name = "guitar"', 'name = "houseplant"', "objects: the object 'houseplant' is there"),
        ("front = [1, 0, 0]", "front = [0, 2, 0]", "objects[0].front: up (0.0, -1.0, 0.0)"),
        ('["an electric guitar", ', '["", ', "objects[0].queries[0]"),
        ('texture = "gravel"', 'texture = "lava"', "ground.texture"),
        ("resolution = [480, 360]", "resolution = [480]", "cameras.resolution"),
        ("count = 12", "count = 0", "cameras.knowledge[0].count"),
        ("fov = 50", "fov = 50\nzoom = 2", "cameras.zoom: an unknown key"),
        ('text = "a bicycle"', 'text = "a bicycle"\ntarget = "x"', "absent[0].target: an unknown"),
    ],
)
def test_a_layout_that_is_wrong_is_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    text = (LAYOUTS / "open.toml").read_text()
    assert old in text
    path = tmp_path / "wrong.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(DatasetError) as caught:
        read_layout(path)
    assert words in str(caught.value) and "wrong.toml" in str(caught.value)


def test_a_layout_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DatasetError, match=r"bytes\.toml: not TOML"):
        read_layout(tmp_path / "bytes.toml")
    with pytest.raises(DatasetError, match=r"none\.toml: cannot be read"):
        read_layout(tmp_path / "none.toml")
