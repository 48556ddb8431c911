"""A small scene on disk and a suite over it, for the flows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from small_queries import MEANINGS, QUERIES
from small_scene import OBJECTS, UP, two_boxes

from datasets.making import take_pictures
from datasets.native_writer import write_scene
from flows.cli import main
from flows.suite import DatasetChoice, SuiteConfig
from gvr_core.methods import MethodConfig
from gvr_core.models.oracle import OracleWorld, oracle_models
from gvr_core.models.registry import ModelConfig
from gvr_core.rendering import get_renderer


@pytest.fixture(scope="session")
def two_boxes_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of one small scene in the native layout; tests do not write into it."""
    folder = tmp_path_factory.mktemp("data")
    scene, labels = two_boxes()
    cameras = {view.name: view.camera for view in scene.views}
    tests = ("v01", "v05")
    write_scene(
        folder / "two-boxes",
        dataset="small",
        name="two-boxes",
        gaussians=scene.gaussians,
        pictures=take_pictures(
            get_renderer("numba"), scene.gaussians, labels, OBJECTS, cameras, tests
        ),
        objects=OBJECTS,
        labels=labels,
        queries=QUERIES,
        up=UP,
        provenance="made for tests",
    )
    return folder


@pytest.fixture
def suite(two_boxes_folder: Path) -> SuiteConfig:
    """The paper's method on the small scene, with models that know its truth."""
    return SuiteConfig(
        name="small",
        datasets=(DatasetChoice(name=f"folder:{two_boxes_folder}"),),
        methods=(MethodConfig(),),
        models=ModelConfig(segmenter="oracle", encoder="oracle", text_segmenter="oracle"),
    )


@pytest.fixture
def oracles(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Test double: whatever models are asked for, they know the truth of the small scene.

    For scenes of one's own, which say nothing of their truth.
    """
    scene, labels = two_boxes()
    known = OracleWorld(scene.gaussians, labels, OBJECTS, MEANINGS)
    monkeypatch.setattr(
        "flows.scene_setup.build_models", lambda config, world: oracle_models(known)
    )
    yield


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Store, results and tracking of this test alone."""
    for variable in ("GVR_STORE", "GVR_RESULTS", "GVR_DATA", "MLFLOW_TRACKING_URI"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("GVR_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.fixture
def gvr(capsys: pytest.CaptureFixture[str]):
    """Run the command line; returns exit code, standard output, standard error."""

    def call(*arguments: str) -> tuple[int, str, str]:
        code = 0
        try:
            main([*arguments])
        except SystemExit as exit_:
            code = exit_.code if isinstance(exit_.code, int) else 1
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call
