"""A small scene on disk and a suite over it, for the flows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from oracle_models import OracleWorld, oracle_models
from small_scene import OBJECTS, UP, two_boxes

from datasets.making import take_pictures
from datasets.native_writer import write_scene
from flows.suite import DatasetChoice, SuiteConfig
from gvr_core.methods import MethodConfig
from gvr_core.rendering import get_renderer
from gvr_core.scene import Query

QUERIES = (
    Query(id="red-1", text="a red box", target=OBJECTS[0]),
    Query(id="red-2", text="the crimson cube", target=OBJECTS[0]),
    Query(id="blue-1", text="a blue box", target=OBJECTS[1]),
    Query(id="absent-1", text="an elephant", absent=True),
)
MEANINGS = {query.text: query.target for query in QUERIES if query.target}


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
    """The paper's method on the small scene."""
    return SuiteConfig(
        name="small",
        datasets=(DatasetChoice(name=f"folder:{two_boxes_folder}"),),
        methods=(MethodConfig(),),
    )


@pytest.fixture
def oracles(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Test doubles: the flows get models that know the truth of the small scene."""
    scene, labels = two_boxes()
    world = OracleWorld(scene.gaussians, labels, OBJECTS, MEANINGS)
    monkeypatch.setattr("flows.scene.build_models", lambda config: oracle_models(world))
    yield
