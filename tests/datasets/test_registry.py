from __future__ import annotations

from pathlib import Path

import pytest
from native_scene import written

from datasets.registry import get_dataset
from gvr_core.errors import ConfigError, DatasetError


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    written(tmp_path / "scenes/one")
    written(tmp_path / "scenes/two")
    (tmp_path / "scenes/.one.123.tmp").mkdir()
    (tmp_path / "scenes/.one.123.tmp/scene.json").write_text("{}")
    return tmp_path / "scenes"


def test_a_folder_of_scenes_is_a_data_set(scenes: Path) -> None:
    found = get_dataset(f"folder:{scenes}", {})
    assert tuple(found.scenes()) == ("one", "two")
    scene = found.load("two").scene
    assert (scene.dataset, scene.name) == (f"folder:{scenes}", "two")
    with pytest.raises(ConfigError, match=r"unknown scene 'three' \(accepted: one, two\)"):
        found.load("three")


def test_a_single_scene_is_a_data_set(scenes: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert tuple(get_dataset(f"folder:{scenes / 'one'}", {}).scenes()) == ("one",)
    monkeypatch.chdir(scenes / "one")
    assert tuple(get_dataset("folder:.", {}).scenes()) == ("one",)


def test_a_folder_without_scenes_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no scene here"):
        get_dataset(f"folder:{tmp_path}", {})


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(
        ConfigError, match=r"'galery'; did you mean 'gallery'\? \(accepted: captures:PATH"
    ):
        get_dataset("galery", {})


def test_the_gallery_has_a_scene_for_each_seed() -> None:
    assert tuple(get_dataset("gallery", {}).scenes()) == tuple(f"gallery_{i}" for i in range(4))
    assert tuple(get_dataset("gallery", {"seeds": [7, 3]}).scenes()) == ("gallery_7", "gallery_3")


@pytest.mark.parametrize("seeds", [[], 3, "12", [1, 1], [-1], [1.5], [True], ["0"], None])
def test_seeds_that_are_none_are_refused(seeds: object) -> None:
    with pytest.raises(ConfigError, match=r"gallery\.settings\.seeds"):
        get_dataset("gallery", {"seeds": seeds})


@pytest.mark.parametrize("name", ["composite", "stress"])
@pytest.mark.parametrize("splats", [3, "", ["a"]])
def test_a_folder_of_splats_that_is_none_is_refused(name: str, splats: object) -> None:
    with pytest.raises(ConfigError, match=rf"{name}\.settings\.splats"):
        get_dataset(name, {"splats": splats})


def test_an_unknown_setting_lists_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"unknown setting colour .*accepted: seeds"):
        get_dataset("gallery", {"colour": "red"})
    with pytest.raises(ConfigError, match=r"unknown setting seeds .*no settings"):
        get_dataset("folder:.", {"seeds": [1]})


def test_composites_need_their_splats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GVR_SPLATS", str(tmp_path / "nowhere"))
    with pytest.raises(DatasetError, match=r"nowhere: no folder of splats"):
        get_dataset("composite", {}).scenes()
    found = get_dataset("composite", {"splats": str(tmp_path)})
    assert tuple(found.scenes()) == ("apart", "crowded", "open")
    with pytest.raises(DatasetError, match=r"\.(ply|splat): missing splat"):
        found.load("open")


def test_stress_scenes_are_a_data_set_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GVR_DATA", str(tmp_path / "data"))
    found = get_dataset("stress", {"splats": str(tmp_path)})
    assert found.name == "stress" and len(found.scenes()) == 10 and "ceiling" in found.scenes()
    assert not set(found.scenes()) & set(
        get_dataset("composite", {"splats": str(tmp_path)}).scenes()
    )
    with pytest.raises(ConfigError, match="unknown scene of stress 'open'"):
        found.load("open")
    with pytest.raises(DatasetError, match=r"plant\.splat: missing splat"):
        found.load("ceiling")
