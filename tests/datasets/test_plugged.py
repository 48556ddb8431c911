"""Data sets of plugins: held to what all data sets keep to."""

from __future__ import annotations

from pathlib import Path

import pytest
from native_scene import written
from plugin_packages import as_in_a_new_process, install

from datasets.base import SceneData
from datasets.registry import check_dataset, get_dataset
from gvr_core import plugins
from gvr_core.errors import ConfigError, PluginError

READER = """
from dataclasses import replace
from pathlib import Path
from datasets.native import read_scene

class Reader:
    name = {name!r}
    def __init__(self, root):
        self.root = Path(root)
    def scenes(self):
        return ["one"]
    def load(self, scene):
        data = read_scene(self.root / scene, {dataset!r}, scene)
        return {wrong}
"""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    written(folder / "one")
    return folder


def reader(
    folder: Path,
    version: str = "1.0",
    name: str = "shelf",
    dataset: str = "shelf",
    wrong: str = "data",
) -> None:
    module = READER.format(name=name, dataset=dataset, wrong=wrong)
    offers = {plugins.DATASETS: {"shelf": "reader:Reader"}}
    install(folder, "shelf-reader", version, offers, {"reader.py": module})
    as_in_a_new_process(folder)


def load(root: Path) -> SceneData:
    return get_dataset("shelf", {"root": str(root)}).load("one")


def test_scenes_are_read_under_the_plugins_name(packages: Path, root: Path) -> None:
    reader(packages)
    check_dataset("shelf")
    found = get_dataset("shelf", {"root": str(root)})
    assert (found.name, tuple(found.scenes())) == ("shelf", ("one",))
    data = found.load("one")
    assert (data.scene.dataset, data.scene.name) == ("shelf", "one")
    with pytest.raises(ConfigError, match=r"accepted: .*gallery.*shelf"):
        check_dataset("shelve")


def test_another_version_changes_every_digest(packages: Path, root: Path) -> None:
    reader(packages)
    first = load(root).digests
    assert load(root).digests == first
    reader(packages, version="1.1")
    newer = load(root).digests
    assert set(newer) == set(first)
    assert all(newer[part] != first[part] for part in first)


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ({"name": "other"}, "calls itself 'other' .*accepted: the name 'shelf'"),
        ({"dataset": "other"}, "is called other/one .*accepted: shelf/one"),
        ({"wrong": "data.scene"}, "is a Scene .*accepted: datasets.base.SceneData"),
        ({"wrong": "replace(data, digests={'views': 'ab'})"}, "no digest of its gaussians, quer"),
    ],
    ids=["own name", "scene's name", "kind", "digests"],
)
def test_what_no_data_set_may_do_is_refused(
    packages: Path, root: Path, wrong: dict[str, str], expected: str
) -> None:
    reader(packages, **wrong)
    with pytest.raises(PluginError, match=rf"shelf-reader 1\.0, .*Reader: .*{expected}"):
        load(root)


def test_settings_that_it_does_not_know_are_refused(packages: Path, root: Path) -> None:
    reader(packages)
    with pytest.raises(PluginError, match=r"Reader: .*colour.*accepted: options"):
        get_dataset("shelf", {"root": str(root), "colour": 1})
