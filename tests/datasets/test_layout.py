from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets.composite import LAYOUTS, STRESS_LAYOUTS
from datasets.layout import Layout, read_layout
from datasets.layout_cameras import OrbitTable, WorldTable
from datasets.layout_objects import SplatTable
from datasets.making import recipe_digest
from gvr_core.errors import DatasetError

BUNDLED = sorted(LAYOUTS.glob("*.toml"))


def table(**changes: object) -> SplatTable:
    given = {
        "name": "thing",
        "file": "thing.ply",
        "up": (0, -1, 0),
        "front": (1, 0, 0),
        "position": (0, 0),
        "height": 1,
        "queries": ("a thing", "some thing"),
    }
    return SplatTable.model_validate({**given, **changes})


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
        (
            "front = [1, 0, 0]",
            "front = [0, 2, 0]",
            "objects[0].front: '[0, 2, 0]': along up (0.0",
        ),
        ('["an electric guitar", ', '["", ', "objects[0].queries[0]"),
        ('texture = "gravel"', 'texture = "lava"', "ground.texture"),
        ("resolution = [480, 360]", "resolution = [480]", "cameras.resolution"),
        ("count = 12", "count = 0", "cameras.knowledge[0].count"),
        ("fov = 50", "fov = 50\nzoom = 2", "cameras.zoom: an unknown key"),
        ('file = "guitar.ply"', 'fil = "guitar.ply"', "objects[0]: a table with exactly one of"),
        (
            'file = "guitar.ply"',
            'file = "guitar.ply"\ntexture = "wood"',
            "objects[0]: a table with",
        ),
        ("up = [0, -1, 0]", "up = [0, 0, 0]", "objects[0].up: '[0, 0, 0]': no direction"),
        ('["an electric guitar", ', "[1, ", "objects[0].queries[0]"),
        ("height = 1.15", "height = 1.15\ncopies = [{ x = 1 }]", "objects[0].copies[0].x: an unkn"),
        (
            "[ground]",
            "[world]\naxis = [0, 0, 0]\n[ground]",
            "world.axis: '[0, 0, 0]': no dir",
        ),
        ("[ground]", "[world]\nscale = 0\n[ground]", "world.scale"),
        ("licence", 'states_up = "perhaps"\nlicence', "states_up"),
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


PHOTOGRAPH = """
[[objects]]
name = "pet"
photograph = "cat"
size = [0.5, 0.4, 0.4]
pitch = 0.02
position = [2, 2]
queries = ["a cat"]
"""
SURFACE = """
[[surfaces]]
corner = [0, 0, 1]
right = [1, 0, 0]
down = [0, 0, -1]
texture = "brick"
tint = [0.5, 0.5, 0.5]
pitch = 0.05
"""
FLOATERS = """
[floaters]
count = 10
seed = 0
lower = [-1, -1, 0]
upper = [1, 1, 1]
size = [0.01, 0.05]
opacity = [0.2, 0.5]
"""


@pytest.mark.parametrize(
    "table, old, new, words",
    [
        (
            PHOTOGRAPH,
            '"cat"',
            '"dog"',
            "objects[3].photograph: 'dog': no photograph; accepted: cat,",
        ),
        (PHOTOGRAPH, "0.5, 0.4, 0.4", "0.5, 0.4", "objects[3].size"),
        (PHOTOGRAPH, "pitch = 0.02", "height = 2", "objects[3].height: an unknown key"),
        (PHOTOGRAPH, 'queries = ["a cat"]', "queries = []", "objects[3].queries"),
        (SURFACE, "down = [0, 0, -1]", "down = [1, 0, -1]", "surfaces[0]: right and down are not"),
        (SURFACE, "right = [1, 0, 0]", "right = [0, 0, 0]", "surfaces[0].right: '[0, 0, 0]'"),
        (SURFACE, "brick", "marble", "surfaces[0].texture"),
        (FLOATERS, "upper = [1, 1, 1]", "upper = [1, 1, 0]", "floaters: lower is not below upper"),
        (FLOATERS, "0.01, 0.05", "0.05, 0.01", "floaters.size: '[0.05, 0.01]': the lower end"),
        (FLOATERS, "0.2, 0.5", "0.2, 1.5", "floaters.opacity[1]"),
        (FLOATERS, "count = 10", "count = 0", "floaters.count"),
        (FLOATERS, "seed = 0", "sed = 0", "floaters.sed: an unknown key"),
    ],
)
def test_a_further_table_that_is_wrong_is_refused(
    tmp_path: Path, table: str, old: str, new: str, words: str
) -> None:
    text, path = (LAYOUTS / "open.toml").read_text(), tmp_path / "wrong.toml"
    path.write_text(text + table)
    read_layout(path)
    assert old in table
    path.write_text(text + table.replace(old, new, 1))
    with pytest.raises(DatasetError) as caught:
        read_layout(path)
    assert words in str(caught.value) and "wrong.toml" in str(caught.value)


def test_the_format_grew_and_old_recipes_stayed() -> None:
    # as the first version of the format had them: other digests would make the scenes anew
    assert {path.stem: recipe_digest(dumped(path)) for path in BUNDLED} == {
        "apart": "1de03ad511f52d25d3f351c57e57d5acabfb8564a0f19c96d394b3f36441c98c",
        "crowded": "4af36493395015d7667e4f082d5237033725ff1fe62f9150ec701c3210eba02b",
        "open": "946ac5800040a92e82786459ec8d635c12b8bc20d80950a20a43fa324fcdda60",
    }
    content = dumped(STRESS_LAYOUTS / "twins.toml")
    assert content["states_up"] is False and "world" not in content
    assert content["objects"][0]["copies"] == [{"position": [0.85, 0.15], "yaw": 15.0}]
    assert "copies" not in content["objects"][1]


def dumped(path: Path) -> dict[str, Any]:
    return read_layout(path).model_dump(mode="json")


@pytest.mark.parametrize("path", sorted(STRESS_LAYOUTS.glob("*.toml")), ids=lambda p: p.stem)
def test_a_dump_is_a_layout_again(path: Path) -> None:
    layout = read_layout(path)
    assert Layout.model_validate(layout.model_dump(mode="json")) == layout


def test_a_world_takes_its_cameras_along() -> None:
    world = WorldTable(axis=(1, 2, 0.5), degrees=50, scale=3, offset=(7, -5, 2))
    camera = next(iter(read_layout(BUNDLED[0]).cameras.cameras().values()))
    points = np.random.default_rng(0).normal(size=(50, 3))
    moved = 3 * points @ world.rotation.T + (7, -5, 2)
    pixels, depth = camera.project(points)
    found, far = world.move_camera(camera).project(moved)
    np.testing.assert_allclose(found, pixels, atol=1e-9)
    np.testing.assert_allclose(far, 3 * depth, atol=1e-9)
    # right-handed about the axis
    quarter = WorldTable(degrees=90).rotation
    np.testing.assert_allclose(quarter @ (1, 0, 0), (0, 1, 0), atol=1e-12)


def test_a_layout_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DatasetError, match=r"bytes\.toml: not TOML"):
        read_layout(tmp_path / "bytes.toml")
    with pytest.raises(DatasetError, match=r"none\.toml: cannot be read"):
        read_layout(tmp_path / "none.toml")
