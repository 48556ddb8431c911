from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np
import pytest
from prefect import flow, get_client, task
from prefect.client.schemas.filters import FlowRunFilter, FlowRunFilterId
from prefect.runtime import flow_run
from prefect.task_runners import ProcessPoolTaskRunner
from pydantic import BaseModel

from gvr_core.errors import ConfigError, StoreError
from tasks.prefect_runtime import PrefectRuntime
from tasks.stage import Stage, StageRun, run_stage
from tasks.store import Artifact, StageOutput, Store

SCENE = "ab" * 32
CONFIG: dict[str, Any] = {
    "render": {"views": 2, "width": 8},
    "depth": {"near": 0.1},
    "device": "cpu",
}


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


def render(
    store: Store, inputs: Mapping[str, Any], config: Mapping[str, Any], calls: list[str]
) -> StageOutput:
    calls.append("render")
    views = config["render"]["views"]
    width = config["render"]["width"]
    picture = np.arange(views * width, dtype=np.float32).reshape(views, width)
    return StageOutput({"pictures": store.put_arrays("pictures", {"rgb": picture})}, {"n": views})


def total(
    store: Store, inputs: Mapping[str, Any], config: Mapping[str, Any], calls: list[str]
) -> dict[str, Artifact]:
    calls.append("total")
    rgb = store.load_arrays(inputs["render"]["pictures"])["rgb"]
    return {"total": store.put_json("total", float(rgb.sum()))}


RENDER = Stage("render", 1, render, ("render",))
TOTAL = Stage("total", 1, total)


@flow(name="two stages", validate_parameters=False)  # so that `calls` is not copied
def two_stages(store: Store, config: dict[str, Any], calls: list[str]) -> list[StageRun]:
    runtime = {"calls": calls}
    first = run_stage(
        RENDER, store, {"scene": SCENE}, config, label="gallery/seed0", runtime=runtime
    )
    second = run_stage(
        TOTAL, store, {"render": first}, config, label="gallery/seed0", runtime=runtime
    )
    return [first, second]


def states(runs: list[StageRun]) -> list[str]:
    return [run.state for run in runs]


# Declarations


def test_slice_holds_the_declared_parts_only() -> None:
    stage = Stage("demo", 1, render, ("render.views", "depth", "device"))
    assert stage.slice(CONFIG) == {
        "render": {"views": 2},
        "depth": {"near": 0.1},
        "device": "cpu",
    }
    assert Stage("demo", 1, render).slice(CONFIG) == {}


def test_slice_of_a_model_and_of_a_dict_are_one_key() -> None:
    class Render(BaseModel):
        views: int = 2
        width: int = 8

    class Config(BaseModel):
        render: Render = Render()

    assert RENDER.key({}, Config()) == RENDER.key({}, CONFIG)


@pytest.mark.parametrize(
    ("dotted", "message"),
    [
        ("segment", r"no 'segment' \(accepted: depth, device, render\)"),
        ("render.height", r"no 'render\.height' \(accepted: views, width\)"),
        ("device.name", r"no 'device\.name'"),
    ],
)
def test_missing_configuration_is_an_error(store: Store, dotted: str, message: str) -> None:
    stage = Stage("demo", 1, render, (dotted,))
    with pytest.raises(ConfigError, match=message):
        run_stage(stage, store, {}, CONFIG)


def test_bad_declarations_are_refused() -> None:
    with pytest.raises(StoreError, match="stage name"):
        Stage("Render views", 1, render)
    with pytest.raises(StoreError, match="version 0"):
        Stage("render", 0, render)


def test_key_is_of_inputs_and_slice_and_of_nothing_else(store: Store) -> None:
    key = RENDER.key({"scene": SCENE}, CONFIG)
    assert key == RENDER.key({"scene": SCENE}, CONFIG | {"depth": {"near": 9.0}, "new": 1})
    assert key != RENDER.key({"scene": "cd" * 32}, CONFIG)
    assert key != Stage("render", 2, render, ("render",)).key({"scene": SCENE}, CONFIG)
    artifact = store.put_json("scene", 1)
    assert RENDER.key({"scene": artifact}, CONFIG) == RENDER.key({"scene": artifact.digest}, CONFIG)


# Without Prefect


def test_without_a_flow_stages_run_directly(store: Store) -> None:
    calls: list[str] = []
    for expected in ("Completed", "Cached"):
        runs = two_stages.fn(store, CONFIG, calls)
        assert states(runs) == [expected, expected]
    assert calls == ["render", "total"]
    assert store.load_json(runs[1]["total"]) == 120.0
    assert runs[0].record.detail == {"n": 2}
    assert not (store.root / "prefect-results").exists()


def test_library_use_does_not_import_prefect(tmp_path: Path) -> None:
    program = """
import sys
from tasks.stage import Stage, run_stage
from tasks.store import Store
store = Store(sys.argv[1])
def number(store, inputs, config):
    return {"n": store.put_json("n", config["n"])}
stage = Stage("demo", 1, number, ("n",))
print(run_stage(stage, store, {}, {"n": 3}).state, run_stage(stage, store, {}, {"n": 3}).state)
print([name for name in sys.modules if name.split(".")[0] in ("prefect", "mlflow", "torch")])
"""
    command = [sys.executable, "-c", program, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["Completed Cached", "[]"]


# Inside Prefect


def test_second_flow_is_cached(prefect_server: PrefectRuntime, store: Store) -> None:
    calls: list[str] = []
    first = two_stages(store, CONFIG, calls)
    second = two_stages(store, CONFIG, calls)
    assert states(first) == ["Completed", "Completed"]
    assert states(second) == ["Cached", "Cached"]
    assert calls == ["render", "total"]
    assert [run.record for run in first] == [run.record for run in second]


def test_server_shows_names_and_states(prefect_server: PrefectRuntime, store: Store) -> None:
    ids: list[UUID] = []

    @flow(name="named")
    def named(label: str) -> None:
        ids.append(UUID(flow_run.get_id()))
        run_stage(RENDER, store, {"scene": SCENE}, CONFIG, label=label, runtime={"calls": []})

    named("gallery/seed0")
    named("gallery/seed0")
    shown: list[tuple[str, str]] = []
    deadline = time.monotonic() + 20
    with get_client(sync_client=True) as client:
        while time.monotonic() < deadline:
            runs = [
                client.read_task_runs(flow_run_filter=FlowRunFilter(id=FlowRunFilterId(any_=[id])))
                for id in ids
            ]
            shown = [(run.name, run.state_name) for each in runs for run in each]
            if [state for _, state in shown] == ["Completed", "Cached"]:
                break
            time.sleep(0.2)
    assert shown == [
        ("render · gallery/seed0", "Completed"),
        ("render · gallery/seed0", "Cached"),
    ]


@pytest.mark.parametrize("damage", ["deleted", "truncated", "flipped"])
def test_damaged_artifact_is_computed_again(
    prefect_server: PrefectRuntime, store: Store, damage: str
) -> None:
    calls: list[str] = []
    first = two_stages(store, CONFIG, calls)
    path = store.path(first[0]["pictures"])
    content = path.read_bytes()
    path.chmod(0o644)
    if damage == "deleted":
        path.unlink()
    elif damage == "truncated":
        path.write_bytes(content[:-1])
    else:
        path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    # The content comes out the same, so the stage after it need not be computed again.
    assert states(two_stages(store, CONFIG, calls)) == ["Completed", "Cached"]
    assert path.read_bytes() == content and store.verify().sound
    assert states(two_stages(store, CONFIG, calls)) == ["Cached", "Cached"]
    assert calls == ["render", "total", "render"]


def test_only_stages_whose_slice_changed_are_computed_again(
    prefect_server: PrefectRuntime, store: Store
) -> None:
    calls: list[str] = []
    two_stages(store, CONFIG, calls)
    elsewhere = CONFIG | {"depth": {"near": 9.0}}
    assert states(two_stages(store, elsewhere, calls)) == ["Cached", "Cached"]
    wider = CONFIG | {"render": {"views": 2, "width": 9}}
    assert states(two_stages(store, wider, calls)) == ["Completed", "Completed"]
    assert states(two_stages(store, CONFIG, calls)) == ["Cached", "Cached"]


def test_refresh_computes_again(prefect_server: PrefectRuntime, store: Store) -> None:
    calls: list[str] = []

    @flow
    def once(refresh: bool) -> str:
        runtime = {"calls": calls}
        return run_stage(RENDER, store, {}, CONFIG, runtime=runtime, refresh=refresh).state

    assert [once(refresh) for refresh in (False, True, False)] == [
        "Completed",
        "Completed",
        "Cached",
    ]
    assert len(calls) == 2


def test_results_computed_without_prefect_are_cached_within(
    prefect_server: PrefectRuntime, store: Store
) -> None:
    calls: list[str] = []
    two_stages.fn(store, CONFIG, calls)
    assert states(two_stages(store, CONFIG, calls)) == ["Cached", "Cached"]
    assert calls == ["render", "total"]


def test_prefect_record_without_store_record_is_no_hit(
    prefect_server: PrefectRuntime, store: Store
) -> None:
    calls: list[str] = []
    runs = two_stages(store, CONFIG, calls)
    store.record_path("render", runs[0].record.key).unlink()
    assert states(two_stages(store, CONFIG, calls)) == ["Completed", "Cached"]


@pytest.mark.parametrize(
    ("output", "message"),
    [
        (StageOutput({}, {"n": np.float32(1)}), "n is of type float32"),
        ({"a": np.zeros(3)}, "accepted: a dict from names to artifacts"),
    ],
)
def test_results_that_are_no_json_are_errors_not_silently_uncached(
    prefect_server: PrefectRuntime, store: Store, output: Any, message: str
) -> None:
    stage = Stage("unfit", 1, lambda store, inputs, config: output)

    @flow
    def unfit() -> None:
        run_stage(stage, store, {}, {})

    for _ in range(2):
        state = unfit(return_state=True)
        assert state.is_failed()
        with pytest.raises(StoreError, match=message):
            state.result()
    assert not list(store.records())


def test_error_of_a_stage_reaches_the_caller_as_it_is(
    prefect_server: PrefectRuntime, store: Store, capfd: pytest.CaptureFixture[str]
) -> None:
    def fails(store: Store, inputs: object, config: object) -> dict[str, Artifact]:
        raise ArithmeticError("no good")

    @flow
    def failing() -> None:
        run_stage(Stage("fails", 1, fails), store, {}, {})

    with pytest.raises(ArithmeticError, match="no good"):
        failing()
    assert capfd.readouterr().err == ""  # the caller reports it


def test_stages_work_in_asynchronous_flows(prefect_server: PrefectRuntime, store: Store) -> None:
    @flow
    async def asynchronous() -> list[str]:
        runtime = {"calls": []}
        return [run_stage(RENDER, store, {}, CONFIG, runtime=runtime).state for _ in range(2)]

    assert asyncio.run(asynchronous()) == ["Completed", "Cached"]


def write_number(store: Store, inputs: object, config: Mapping[str, Any]) -> dict[str, Artifact]:
    return {"number": store.put_json("number", config["number"])}


NUMBER = Stage("number", 1, write_number, ("number",))


@task(persist_result=False)
def one_scene(root: str, number: int) -> str:
    return run_stage(NUMBER, Store(root), {}, {"number": number}, label=f"scene {number}").state


@flow(task_runner=ProcessPoolTaskRunner(max_workers=1))
def many_scenes(root: str) -> list[str]:
    return one_scene.map([root] * 2, [1, 2]).result()


def test_scenes_in_a_process_pool_share_the_cache(
    prefect_server: PrefectRuntime, store: Store
) -> None:
    assert run_stage(NUMBER, store, {}, {"number": 2}).state == "Completed"
    assert many_scenes(str(store.root)) == ["Completed", "Cached"]


RACER = """
import sys, time
from pathlib import Path
from prefect import flow
from tasks.prefect_runtime import prefect_runtime
from tasks.stage import Stage, run_stage
from tasks.store import Store

store, folder, name = Store(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]

def slow(store, inputs, config):
    with (folder / "log").open("a") as file:
        file.write("computed\\n")
    time.sleep(1.0)
    return {"n": store.put_json("n", 1)}

@flow
def race():
    (folder / name).touch()
    while len(list(folder.glob("ready*"))) < 2:
        time.sleep(0.005)
    return run_stage(Stage("slow", 1, slow), store, {}, {}).state

with prefect_runtime(store) as runtime:
    print(race(), runtime.own_server)
"""


def test_two_flows_in_two_processes_compute_once(
    prefect_server: PrefectRuntime, store: Store, tmp_path: Path
) -> None:
    racers = [
        subprocess.Popen(
            [sys.executable, "-c", RACER, str(store.root), str(tmp_path), f"ready{index}"],
            stdout=subprocess.PIPE,
            text=True,
        )
        for index in range(2)
    ]
    answers = sorted(racer.communicate(timeout=60)[0].strip() for racer in racers)
    assert answers == ["Cached False", "Completed False"]
    assert (tmp_path / "log").read_text() == "computed\n"
