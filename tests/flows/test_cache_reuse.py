"""What is recomputed, and what is not: asserted on the states that Prefect itself holds."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import shutil
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
from prefect import get_client
from prefect.client.schemas.sorting import TaskRunSort
from scipy import sparse

from flows.benchmark import BenchmarkOutcome, run_benchmark
from flows.lines import ModelSet
from flows.run_config import RunConfig
from flows.suite import DatasetChoice, SuiteConfig
from gvr_core.methods import MethodConfig
from gvr_core.rendering import Rendering, get_renderer
from gvr_core.rendering.base import mask_by_mask, one_by_one
from tasks.prefect_runtime import PrefectRuntime, prefect_runtime
from tasks.store import Store

STAGES = ["render", "depth", "masks", "encode", "index", "query", "segment", "evaluate"]


@pytest.fixture
def bench(prefect_server: PrefectRuntime, tmp_path: Path):
    """Run a suite on a store of this test; returns the outcome."""

    def run(suite: SuiteConfig) -> BenchmarkOutcome:
        store = tmp_path / "store"
        with prefect_runtime(Store(store), home=prefect_server.home, isolated=True):
            return run_benchmark(suite, store, tmp_path / "results")

    return run


def states(outcome: BenchmarkOutcome) -> dict[str, str]:
    """Stage -> state of the only scene and method."""
    (scene,) = outcome.result.scenes
    assert scene.status == "completed", scene.error
    return {timing.stage: timing.state for timing in scene.stages}


def new_task_runs(since: datetime) -> list[tuple[str, str]]:
    """Stage and state of the task runs that began since then.

    The server learns of them a moment later, and of those of earlier tests perhaps only now.
    """

    async def read() -> list[tuple[str, str]]:
        async with get_client() as client:
            runs = await client.read_task_runs(sort=TaskRunSort.EXPECTED_START_TIME_DESC, limit=100)
            # A flow inside a flow stands among the task runs too.
            named = [
                (run.name.split(" ")[0], run.state_name or "")
                for run in runs
                if run.expected_start_time is not None and run.expected_start_time >= since
            ]
            return [run for run in named if run[0] in STAGES]

    fresh: list[tuple[str, str]] = []
    for _ in range(60):
        fresh = asyncio.run(read())
        if len(fresh) >= len(STAGES) and all(s in ("Completed", "Cached") for _, s in fresh):
            break
        time.sleep(0.5)
    return sorted(fresh)


def test_a_second_run_computes_nothing(bench, suite, prefect_server) -> None:
    before = datetime.now(UTC)
    first = bench(suite)
    assert states(first) == dict.fromkeys(STAGES, "computed")
    assert new_task_runs(before) == sorted((stage, "Completed") for stage in STAGES)
    before = datetime.now(UTC)
    second = bench(suite)
    assert states(second) == dict.fromkeys(STAGES, "cached")
    assert new_task_runs(before) == sorted((stage, "Cached") for stage in STAGES)
    assert second.rows == first.rows


def test_other_queries_recompute_the_query_and_later_only(bench, suite) -> None:
    bench(suite)
    fewer = bench(suite.model_copy(update={"limit": 2}))
    assert list(states(fewer).values()) == ["cached"] * 5 + ["computed"] * 3
    assert {row.query for row in fewer.rows} == {"red-1", "red-2"}


def test_a_new_wording_on_disk_recomputes_the_query_and_later_only(
    bench, suite, two_boxes_folder, tmp_path
) -> None:
    mine = tmp_path / "mine"
    shutil.copytree(two_boxes_folder, mine)
    # Not oracles, which know what the wordings mean and so depend on them.
    models = (ModelSet(encoder="random:0"),)
    datasets = (DatasetChoice(name=f"folder:{mine}"),)
    suite = suite.model_copy(update={"datasets": datasets, "models": models})
    bench(suite)
    path = mine / "two-boxes" / "queries.json"
    text = path.read_text()
    assert "the crimson cube" in text
    path.write_text(text.replace("the crimson cube", "the scarlet cube"))
    assert list(states(bench(suite)).values()) == ["cached"] * 5 + ["computed"] * 3


@dataclasses.dataclass(frozen=True)
class DimmedRenderer:
    """Test double: another renderer, whose pictures are a little darker and further away."""

    name: str = "test-dimmed/1"

    def render(
        self, gaussians, camera, background=(0.0, 0.0, 0.0), mask=None, shown=None
    ) -> Rendering:
        given = get_renderer("numba").render(gaussians, camera, background, mask, shown)
        return dataclasses.replace(
            given,
            rgb=given.rgb * 0.9,
            expected_depth=given.expected_depth * 1.001,
            median_depth=given.median_depth * 1.001,
        )

    def render_many(self, *arguments) -> Iterator[Rendering]:
        return one_by_one(self, *arguments)

    def weights(self, *arguments) -> sparse.csr_array:
        return mask_by_mask(self, *arguments)


def test_another_renderer_recomputes_everything(bench, suite, monkeypatch) -> None:
    bench(suite)
    monkeypatch.setattr("flows.scene_setup.get_renderer", lambda name: DimmedRenderer())
    assert set(states(bench(suite)).values()) == {"computed"}


def test_an_ablation_reuses_the_preparation(bench, suite) -> None:
    bench(suite)
    method = MethodConfig(label="w/o SMFI", segment={"smfi": False})
    ablated = bench(suite.model_copy(update={"methods": (method,)}))
    assert list(states(ablated).values()) == ["cached"] * 6 + ["computed"] * 2


@pytest.mark.parametrize("damage", ["delete", "truncate", "flip"])
def test_a_damaged_artifact_is_computed_again(bench, suite, tmp_path, damage) -> None:
    first = bench(suite)
    store = Store(tmp_path / "store")
    key = next(t.key for t in first.result.scenes[0].stages if t.stage == "masks")
    record = store.lookup("masks", key)
    assert record is not None
    path = store.path(record.artifacts["patches"])
    path.chmod(0o644)
    if damage == "delete":
        path.unlink()
    elif damage == "truncate":
        path.write_bytes(path.read_bytes()[:-7])
    else:
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 1
        path.write_bytes(data)
    second = bench(suite)
    assert states(second) == dict.fromkeys(STAGES, "cached") | {"masks": "computed"}
    assert second.rows == first.rows
    assert Store(tmp_path / "store").verify().sound


def test_the_record_on_disk_holds_the_whole_configuration(bench, suite) -> None:
    outcome = bench(suite)
    saved = json.loads((outcome.folder / "result.json").read_text())
    assert SuiteConfig.model_validate(saved["config"]) == suite
    assert saved["config"]["methods"][0]["segment"]["ring_views"] == 4
    assert (outcome.folder / "rows.parquet").stat().st_size > 0
    pictures = sorted(path.name for path in (outcome.folder / "pictures").rglob("*.png"))
    assert pictures == ["absent-1.png", "blue-1.png", "red-1.png", "red-2.png"]


def test_oracle_models_find_the_boxes_through_the_whole_flow(bench, suite) -> None:
    outcome = bench(suite)
    ious = [row.metrics["iou"] for row in outcome.rows if row.protocol == "flags_3d/1"]
    near = [row.metrics["within_radius"] for row in outcome.rows if row.protocol == "flags_3d/1"]
    assert len(ious) == 3
    assert min(ious) >= 0.75
    assert min(near) == 1.0
    seen = [row.metrics["iou"] for row in outcome.rows if row.protocol == "gvr.in_scene_2d/1"]
    assert len(seen) == 6
    assert min(seen) > 0.7


def test_a_method_that_fails_leaves_the_others_be(bench, suite, monkeypatch) -> None:
    from flows import scene as scene_module

    real = scene_module.line_job

    def breaks(data, suite, line, *others):
        if line.name == "broken":
            raise RuntimeError("out of luck")
        return real(data, suite, line, *others)

    monkeypatch.setattr(scene_module, "line_job", breaks)
    methods = (MethodConfig(label="broken"), MethodConfig())
    run = RunConfig(retry_delay_seconds=0)
    outcome = bench(suite.model_copy(update={"methods": methods, "run": run}))
    assert [scene.status for scene in outcome.result.scenes] == ["failed", "completed"]
    place = f"{suite.datasets[0].name}/two-boxes"
    assert outcome.failed == [f"{place} · broken: RuntimeError: out of luck (tried 2 times)"]
    assert not outcome.bad_input
