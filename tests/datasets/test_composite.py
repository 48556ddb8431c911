from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from small_layout import LAYOUT, layouts, write_splats

from datasets import composite
from datasets.base import SceneData
from datasets.composite import LAYOUTS, CompositeDataset, splats_folder
from datasets.images import read_image
from datasets.layout import read_layout
from datasets.making import visible
from gvr_core.errors import ConfigError, DatasetError
from gvr_core.rendering.base import get_renderer

REPOSITORY = Path(__file__).resolve().parent.parent.parent


@pytest.fixture(scope="module")
def splats(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_splats(tmp_path_factory.mktemp("splats"))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory, splats: Path) -> SceneData:
    folder = tmp_path_factory.mktemp("composite")
    return CompositeDataset(folder / "made", splats, layouts(folder / "layouts")).load("pair")


def test_objects_stand_where_the_layout_says(data: SceneData) -> None:
    assert data.truth.objects == ("red", "blue")
    for target, place_xy, height in (("red", (0, -1), 0.8), ("blue", (0.25, 1), 1.2)):
        means = data.scene.gaussians.means[data.truth.flags(target)]
        assert len(means) == 12**3
        low, high = means.min(axis=0), means.max(axis=0)
        np.testing.assert_allclose((low + high)[:2] / 2, place_xy, atol=1e-4)
        np.testing.assert_allclose((low[2], high[2]), (0, height), atol=1e-3)
        np.testing.assert_allclose((high - low)[:2], height / 2, atol=1e-3)
    ground = data.scene.gaussians.means[data.truth.labels == -1]
    assert len(ground) == 3600 and not ground[:, 2].any()


def test_views_queries_and_provenance(data: SceneData) -> None:
    assert [view.name for view in data.scene.views] == ["view_000", "view_001"]
    assert [view.name for view in data.truth.test_views] == ["test_0"]
    assert [(q.id, q.target, q.absent) for q in data.queries] == [
        ("red-1", "red", False),
        ("red-2", "red", False),
        ("blue-1", "blue", False),
        ("blue-2", "blue", False),
        ("absent-1", None, True),
    ]
    np.testing.assert_array_equal(data.scene.up_direction, (0, 0, 1))


def test_a_mask_ends_where_another_object_covers(data: SceneData) -> None:
    view = data.truth.test_views[0]
    rgb = read_image(view.image).astype(int)
    red, blue = data.truth.mask(view, "red"), data.truth.mask(view, "blue")
    assert not (red & blue).any()
    assert (rgb[red, 0] > rgb[red, 2]).mean() > 0.98
    assert (rgb[blue, 2] > rgb[blue, 0]).mean() > 0.98
    alone = get_renderer("numba").render(
        data.scene.gaussians.subset(data.truth.flags("blue")), view.camera
    )
    whole = alone.alpha > 0.5
    covered = (red & whole).sum()
    # red stands in front: what it covers is missing from blue, and nothing else is
    assert covered > 30
    assert abs(int(blue.sum()) - int(whole.sum() - covered)) < 0.1 * whole.sum()


def test_a_scene_is_made_again_only_when_something_changed(
    tmp_path: Path, splats: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []
    original = composite.make_scene

    def counted(folder, name, *rest) -> None:
        made.append(name)
        original(folder, name, *rest)

    monkeypatch.setattr(composite, "make_scene", counted)
    own = tmp_path / "splats"
    own.mkdir()
    for path in splats.glob("*.ply"):
        (own / path.name).write_bytes(path.read_bytes())

    def load() -> SceneData:
        return CompositeDataset(tmp_path / "made", own, tmp_path / "layouts").load("pair")

    layouts(tmp_path / "layouts")
    first = load()
    assert load().digests == first.digests and len(made) == 1
    layouts(tmp_path / "layouts", "# a comment changes nothing\n" + LAYOUT)
    load()
    assert len(made) == 1
    layouts(tmp_path / "layouts", LAYOUT.replace("a zebra", "a horse"))
    second = load()
    assert len(made) == 2
    changed = {part for part in first.digests if first.digests[part] != second.digests[part]}
    assert changed == {"queries"}
    (own / "red.ply").write_bytes((own / "blue.ply").read_bytes())
    assert load().digests["gaussians"] != second.digests["gaussians"] and len(made) == 3
    monkeypatch.setattr(composite, "VERSION", composite.VERSION + 1)
    load()
    assert len(made) == 4
    (tmp_path / "made/pair/scene.json").write_text("damaged")
    load()
    assert len(made) == 5


@pytest.mark.parametrize("states", [True, False])
def test_a_moved_world_looks_the_same_and_knows_its_up(
    tmp_path: Path, splats: Path, data: SceneData, states: bool
) -> None:
    world = "[world]\naxis = [1, 0, 0]\ndegrees = 90\nscale = 10\noffset = [100, 200, -50]\n"
    text = f"states_up = {str(states).lower()}\n" + LAYOUT + world
    folder = layouts(tmp_path / "layouts", text)
    moved = CompositeDataset(tmp_path / "made", splats, folder, "elsewhere").load("pair")
    assert moved.scene.dataset == "elsewhere"
    if states:
        np.testing.assert_allclose(moved.scene.up_direction, (0, -1, 0), atol=1e-9)
    else:
        assert moved.scene.up is None
        assert '"up": null' in (tmp_path / "made/pair/scene.json").read_text()
    for one, other in zip(data.scene.views, moved.scene.views, strict=True):
        difference = read_image(one.image).astype(int) - read_image(other.image)
        assert np.abs(difference).max() <= 2
    assert moved.scene.gaussians.means.mean(axis=0)[0] > 90


RACE = """
import sys, time
from pathlib import Path
from datasets import composite
original = composite.make_scene
def slow(*args):
    with open(sys.argv[1] + "/log", "a") as log:
        log.write("made\\n")
    time.sleep(0.5)
    original(*args)
composite.make_scene = slow
root = Path(sys.argv[1])
while not (root / "go").exists():
    time.sleep(0.01)
data = composite.CompositeDataset(root / "made", Path(sys.argv[2]), root / "layouts").load("pair")
print(data.digests["gaussians"])
"""


def test_two_processes_make_a_scene_once(tmp_path: Path, splats: Path) -> None:
    layouts(tmp_path / "layouts")
    command = [sys.executable, "-c", RACE, str(tmp_path), str(splats)]
    racers = [
        subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    (tmp_path / "go").touch()
    answers = [racer.communicate(timeout=300)[0] for racer in racers]
    assert [racer.returncode for racer in racers] == [0, 0]
    assert answers[0] == answers[1] != ""
    assert (tmp_path / "log").read_text() == "made\n"


def test_where_splats_are_looked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder in ("given", "own", "shared/data/splats"):
        (tmp_path / folder).mkdir(parents=True)
    monkeypatch.setenv("GVR_SHARED", str(tmp_path / "shared"))
    monkeypatch.delenv("GVR_SPLATS", raising=False)
    assert splats_folder() == tmp_path / "shared/data/splats"
    monkeypatch.setenv("GVR_SPLATS", str(tmp_path / "own"))
    assert splats_folder() == tmp_path / "own"
    assert splats_folder(tmp_path / "given") == tmp_path / "given"
    monkeypatch.setenv("GVR_SPLATS", str(tmp_path / "nowhere"))
    with pytest.raises(DatasetError, match=r"nowhere: no folder of splats.*GVR_SPLATS"):
        splats_folder()


def test_an_unknown_scene_is_refused(tmp_path: Path, splats: Path) -> None:
    found = CompositeDataset(tmp_path, splats, layouts(tmp_path / "layouts"))
    with pytest.raises(ConfigError, match=r"'single' \(accepted: pair\)"):
        found.load("single")


def small(text: str) -> str:
    """A bundled layout with small pictures: it is the arrangement that counts."""
    return text.replace("resolution = [480, 360]", "resolution = [160, 120]")


@pytest.mark.slow
@pytest.mark.parametrize("name, clear", [("open", 0.9), ("apart", 0.9), ("crowded", 0.0)])
def test_bundled_scenes_of_real_splats(
    tmp_path: Path, shared: Path, name: str, clear: float
) -> None:
    (tmp_path / "layouts").mkdir()
    text = small((LAYOUTS / f"{name}.toml").read_text())
    (tmp_path / f"layouts/{name}.toml").write_text(text)
    data = CompositeDataset(tmp_path / "made", shared / "data/splats", tmp_path / "layouts").load(
        name
    )
    gaussians, labels = data.scene.gaussians, data.truth.labels
    renderer, objects = get_renderer("numba"), len(data.truth.objects)
    heights = [np.percentile(gaussians.means[labels == i, 2], 99) for i in range(objects)]
    items = read_layout(LAYOUTS / f"{name}.toml").objects
    np.testing.assert_allclose(heights, [item.height + item.lift for item in items], rtol=1e-3)
    shares = []
    for view in (*data.scene.views, *data.truth.test_views):
        seen = visible(renderer, gaussians, labels, objects, view.camera)
        for i in range(objects):
            shown = (labels == i) | (labels == -1)
            own = np.where(labels[shown] == i, 0, -1).astype(np.int16)
            alone = visible(renderer, gaussians.subset(shown), own, 1, view.camera)[0]
            assert alone.sum() > 100
            shares.append((seen[i] & alone).sum() / alone.sum())
    unhidden = (np.array(shares).reshape(-1, objects) > 0.95).mean(axis=0)
    if clear:
        assert unhidden.min() >= clear
    else:
        # partly covered: each thing is, in some view, and yet none is lost in most of them
        assert unhidden.max() < 0.95
        assert (np.array(shares) > 0.5).mean() > 0.8
