"""No pickle is loaded from any file: watched over a whole benchmark, and planted in every file.

What is unpickled at all, and from where:

* numba reads its own cache of compiled kernels, beside the source or where NUMBA_CACHE_DIR says:
  machine code, to be trusted as the source is;
* nothing else. (``torch.load(weights_only=True)`` has a reader of its own, which looks up no name
  that is not on its list; `tests/hostile/test_hostile_weights.py` is about that.)
"""

from __future__ import annotations

import pickle
import shutil
from contextlib import suppress
from pathlib import Path

import pytest
from hostile_targets import evil
from unpickling import plant, unpickling

from datasets.native import read_scene
from flows.benchmark import run_benchmark
from flows.suite import SuiteConfig
from gvr_core.errors import GVRError
from reports.mlflow_sink import sync
from tasks.prefect_runtime import PrefectRuntime, prefect_runtime
from tasks.store import Store

NUMBA = "/numba/core/caching.py:"


def run(suite: SuiteConfig, folder: Path, server: PrefectRuntime) -> Path:
    """The result's folder."""
    with prefect_runtime(Store(folder / "store"), home=server.home, isolated=True):
        outcome = run_benchmark(suite, folder / "store", folder / "results")
    assert [scene.status for scene in outcome.result.scenes] == ["completed"]
    return outcome.folder


def test_the_watch_sees(tmp_path: Path) -> None:
    with unpickling() as watch:
        pickle.loads(pickle.dumps(Path))
    assert [item[:2] for item in watch.by_others(())] == [("pathlib", "Path")]


def test_a_benchmark_unpickles_nothing(
    suite: SuiteConfig, tmp_path: Path, prefect_server: PrefectRuntime
) -> None:
    with unpickling() as watch:
        folder = run(suite, tmp_path, prefect_server)  # everything is computed
        run(suite, tmp_path, prefect_server)  # everything is read back
        sync(folder, f"sqlite:///{tmp_path}/mlflow.db")
    assert watch.by_others((NUMBA,)) == []


@pytest.mark.slow
def test_an_evil_pickle_in_every_file_does_not_run(
    suite: SuiteConfig, tmp_path: Path, prefect_server: PrefectRuntime
) -> None:
    data = tmp_path / "data"
    shutil.copytree(Path(suite.datasets[0].name.removeprefix("folder:")), data)
    mine = suite.model_copy(
        update={"datasets": (suite.datasets[0].model_copy(update={"name": f"folder:{data}"}),)}
    )
    folder = run(mine, tmp_path, prefect_server)
    bitten = tmp_path / "bitten"
    content = evil(f"touch {bitten}")
    kept = [path for path in (tmp_path / "store").rglob("*") if path.is_file()]
    assert {path.suffix for path in kept} >= {".json", ".safetensors", ".png"}
    for path in kept:
        plant(path, content)
    with unpickling() as watch:
        run(mine, tmp_path, prefect_server)  # all of it is computed anew
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            before = plant(path, content)
            with pytest.raises(GVRError):
                sync(folder, f"sqlite:///{tmp_path}/mlflow.db")
            plant(path, before)
        for path in [path for path in (tmp_path / "artifacts").rglob("*") if path.is_file()]:
            plant(path, content)
        sync(folder, f"sqlite:///{tmp_path}/mlflow.db")
        scene = data / "two-boxes"
        for path in sorted(path for path in scene.rglob("*") if path.is_file()):
            before = plant(path, content)
            with suppress(GVRError):
                read_scene(scene)
            plant(path, before)
    assert watch.by_others((NUMBA,)) == []
    assert not bitten.exists()
