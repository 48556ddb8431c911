"""A plan names what a run would compute, and the run then computes just that."""

from __future__ import annotations

import pytest

from flows.benchmark import run_benchmark
from flows.plan import plan
from tasks.prefect_runtime import PrefectRuntime, prefect_runtime
from tasks.store import Store

STAGES = ["render", "depth", "masks", "encode", "index", "query", "segment", "evaluate"]


@pytest.fixture
def ran(prefect_server: PrefectRuntime, tmp_path, suite):
    """The suite after one run, and its store."""
    store = tmp_path / "store"
    with prefect_runtime(Store(store), home=prefect_server.home, isolated=True):
        run_benchmark(suite, store, tmp_path / "results")
    return Store(store)


def test_an_empty_store_has_nothing(tmp_path, suite) -> None:
    (line,) = plan(suite, Store(tmp_path / "store"))
    assert (line.scene, line.line) == ("two-boxes", "gvr-paper")
    assert line.stages == dict.fromkeys(STAGES, "to compute")
    assert not (tmp_path / "store").exists()


def test_what_a_run_left_is_found(ran, suite) -> None:
    (line,) = plan(suite, ran)
    assert line.to_compute == []
    (fewer,) = plan(suite.model_copy(update={"limit": 2}), ran)
    assert fewer.to_compute == ["query", "segment", "evaluate"]


def test_what_builds_on_a_missing_stage_is_missing_too(ran, suite) -> None:
    for path in (ran.root / "records" / "masks").glob("*.json"):
        path.unlink()
    (line,) = plan(suite, ran)
    assert line.to_compute == STAGES[2:]


def test_the_command_lists_without_a_prefect_or_a_store(
    suite, two_boxes_folder, tmp_path, home, gvr
) -> None:
    path = tmp_path / "small.toml"
    path.write_text(
        f'name = "small"\n[[datasets]]\nname = "folder:{two_boxes_folder}"\n'
        '[models]\nsegmenter = "oracle"\nencoder = "oracle"\ntext_segmenter = "oracle"\n'
    )
    code, said, _ = gvr("run", str(path), "--dry-run")
    assert code == 0
    assert "0 of 8" in said
    assert "8 stages to compute" in said
    assert not home.exists()
