"""A small layout of two splats, red and blue, and the splats themselves."""

from __future__ import annotations

from pathlib import Path

from small_scene import box, flat_gaussians

from gvr_core.splat_io import write_ply

OBJECT = """
[[objects]]
name = "{name}"
file = "{name}.ply"
up = [0, -1, 0]
front = [1, 0, 0]
position = [{x}, {y}]
height = {height}
queries = ["a {name} thing", "something {name}"]
"""

REST = """
[[absent]]
text = "a zebra"
[ground]
texture = "brick"
tint = [0.5, 0.5, 0.5]
size = [6.0, 6.0]
pitch = 0.1
[cameras]
resolution = [96, 72]
fov = 50
target = [0, 0, 0.3]
[[cameras.knowledge]]
count = 2
radius = 4
yaw = [-30, 90]
pitch = [20, 30]
[[cameras.test]]
count = 1
radius = 4
yaw = [0, 10]
pitch = [5, 5]
"""

LAYOUT = (
    'licence = "made by a test"\n'
    + OBJECT.format(name="red", x=0, y=-1, height=0.8)
    + OBJECT.format(name="blue", x=0.25, y=1, height=1.2)
    + REST
)


def write_splats(folder: Path) -> Path:
    # standing on their heads, as captures do: y points down; 1 x 2 x 1 in the files' own unit
    tall = box((3.0, -5.0, 2.0), 1.0, 12) * (1, 2, 1)
    write_ply(folder / "red.ply", flat_gaussians(tall, (0.9, 0.1, 0.1), 0.06))
    write_ply(folder / "blue.ply", flat_gaussians(tall, (0.1, 0.1, 0.9), 0.06))
    return folder


def layouts(folder: Path, text: str = LAYOUT) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "pair.toml").write_text(text)
    return folder
