"""Another version of a plugin computes again what the plugin has a part in, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from native_scene import parts, written
from plugin_packages import as_in_a_new_process, install

from datasets.base import SceneData
from datasets.native import read_scene
from flows.scene_setup import make_job
from gvr_core import plugins
from gvr_core.methods import MethodConfig
from gvr_core.models.registry import ModelConfig
from tasks.stages import STAGES, run_stages
from tasks.store import Store

NAMES = [planned.stage.name for planned in STAGES]
METHOD = """
from gvr_core.methods.lift import Lift, LiftConfig

def make(tools, name, threshold=0.5):
    return Lift(tools, LiftConfig(threshold=threshold, phrases=False), name=name)
"""
ENCODER = """
from gvr_core.models.random_encoder import RandomEncoder as make
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> SceneData:
    folder = written(tmp_path_factory.mktemp("data") / "two-boxes", **parts(views=5))
    return read_scene(folder)


def computed(packages: Path, data: SceneData, store: Path, threshold: float = 0.5) -> list[str]:
    """Stages that a run computes, with the plugins as a process that starts now finds them."""
    as_in_a_new_process(packages)
    method = MethodConfig(method="threshold", options={"threshold": threshold})
    models = ModelConfig(segmenter="oracle", encoder="blind", options={"blind": {"seed": 1}})
    runs = run_stages(make_job(data, method, Store(store), models))
    return [name for name, run in runs.items() if not run.cached]


def test_versions_code_and_options_are_in_the_keys(
    packages: Path, data: SceneData, tmp_path: Path
) -> None:
    data = replace(data, queries=data.queries[:1])
    store = tmp_path / "store"

    def method(version: str, code: str = METHOD) -> None:
        offers = {plugins.METHODS: {"threshold": "meth:make"}}
        install(packages, "meth", version, offers, {"meth.py": code})

    def encoder(version: str) -> None:
        offers = {plugins.MODELS: {"blind": "enc:make"}}
        install(packages, "enc", version, offers, {"enc.py": ENCODER})

    method("1.0")
    encoder("1.0")
    from_index = NAMES[NAMES.index("index") :]
    assert computed(packages, data, store) == NAMES
    assert computed(packages, data, store) == []
    # Stages go by the content of what they get: same answers, same evaluation, and an encoder
    # that gives the same vectors leaves the index as it is.
    method("1.1")
    assert computed(packages, data, store) == from_index[:-1]
    method("1.1", METHOD + "# edited\n")
    assert computed(packages, data, store) == from_index[:-1]
    assert set(computed(packages, data, store, 0.6)) >= set(from_index[:-1])
    encoder("2.0")
    assert computed(packages, data, store, 0.6) == ["encode", "query", "segment"]
    method("1.0")
    encoder("1.0")
    assert computed(packages, data, store) == []
