"""Plugins in suites, on the command line, and in the doctor's report."""

from __future__ import annotations

from pathlib import Path

import pytest
from plugin_packages import install

from flows import doctor
from flows.suite import SuiteConfig, override, read_suite
from gvr_core import plugins
from gvr_core.errors import ConfigError

METHOD = """
from gvr_core.methods.gvr_paper import GVRPaper, LocateConfig, SegmentConfig

def make(tools, name, top_k=1):
    return GVRPaper(tools, LocateConfig(top_k=top_k), SegmentConfig(), name)
"""


def toy(folder: Path, module: str = METHOD) -> None:
    install(folder, "toy", "1.0", {plugins.METHODS: {"toy": "toy_x:make"}}, {"toy_x.py": module})


def test_a_suite_names_a_plugins_method(packages: Path, suite: SuiteConfig) -> None:
    toy(packages)
    chosen = override(suite, methods=["toy"])
    assert [line.name for line in chosen.lines()] == ["toy"]
    again = SuiteConfig.model_validate_json(chosen.model_dump_json())
    assert again == chosen
    with pytest.raises(ConfigError, match=r"unknown method 'tyo' .*gvr-paper.*toy"):
        override(suite, methods=["tyo"])


def test_the_projects_own_methods_take_no_options(packages: Path, tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text(
        'name = "s"\n[[datasets]]\nname = "gallery"\n'
        '[[methods]]\nmethod = "lift"\noptions = { threshold = 0.4 }\n'
    )
    with pytest.raises(ConfigError, match=r"s\.toml: options of lift .*options of a plugin's"):
        read_suite(str(path))


@pytest.mark.parametrize("command", ["run", "ground"])
def test_a_plugin_that_cannot_be_imported_is_one_line(
    gvr, home: Path, packages: Path, two_boxes_folder: Path, tmp_path: Path, command: str
) -> None:
    toy(packages, "import nothing_of_that_name")
    suite = tmp_path / "s.toml"
    suite.write_text(
        f'name = "s"\n[[datasets]]\nname = "folder:{two_boxes_folder}"\n'
        '[[methods]]\nmethod = "toy"\n'
    )
    scene = two_boxes_folder / "two-boxes"
    splat = str(scene / "point_cloud/iteration_30000/point_cloud.ply")
    arguments = {
        "run": ["run", str(suite), "--no-mlflow"],
        "ground": ["ground", splat, "--cameras", str(scene), "--query", "x", "--method", "toy"],
    }
    code, _, err = gvr(*arguments[command])
    assert code == 2
    assert "toy 1.0, [gvr_bench.methods] toy = toy_x:make: ModuleNotFoundError" in err
    assert "Traceback" not in err
    assert not home.exists()


def test_a_method_that_reads_answers_is_none_for_ground(gvr, home: Path) -> None:
    code, _, err = gvr(
        "ground", "x.ply", "--cameras", ".", "--query", "x", "--method", "predictions"
    )
    assert code == 2
    assert "unknown method 'predictions'" in err


def test_the_doctor_lists_plugins_and_what_is_wrong_with_them(packages: Path) -> None:
    assert doctor._plugins() == ("ok", "none installed")
    toy(packages)
    plugins._entry_points.cache_clear()
    assert doctor._plugins() == ("ok", "methods: toy (toy 1.0)")
    offers = {
        plugins.DATASETS: {"gallery": "bad:make"},
        plugins.MODELS: {"mine": "bad:make", "sam:mine": "bad:make"},
    }
    install(packages, "bad", "2", offers, {"bad.py": "import nothing_of_that_name"})
    plugins._entry_points.cache_clear()
    state, text = doctor._plugins()
    assert state == "bad"
    assert "datasets: gallery (bad 2), never used: the project has its own of that name" in text
    assert "models: sam:mine (bad 2), never used" in text
    assert "models: mine (bad 2), which cannot be used: bad 2, [gvr_bench.models] mine = " in text
    assert text.endswith("methods: toy (toy 1.0)")
