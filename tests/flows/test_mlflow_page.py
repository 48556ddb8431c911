"""The searches of docs/mlflow.md, against a real MLflow server that real runs have filled."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import mlflow
import pandas as pd
import pytest

from flows.benchmark import run_benchmark
from flows.job import fill_mlflow
from flows.suite import DatasetChoice, SuiteConfig
from gvr_core.methods import MethodConfig
from gvr_core.models.registry import ModelConfig
from reports.mlflow_server import start_server
from reports.mlflow_store import LocalStore
from reports.record import Result
from reports.result_io import read_result
from tasks.prefect_runtime import PrefectRuntime, prefect_runtime
from tasks.store import Store

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "mlflow.md").read_text(encoding="utf-8")
FILTERS = re.findall(r"^\| `([a-z]+\..+)` \| ", PAGE, flags=re.MULTILINE)
SNIPPETS = re.findall(r"^```python\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)
ADDRESS, REVISION, CPUS = "http://127.0.0.1:5000", "0123abcd", "2 CPUs"


@dataclass(frozen=True)
class Filled:
    """A server, and what its store was filled from."""

    url: str
    nights: tuple[Result, Result]
    broken: Result


@pytest.fixture(scope="module")
def filled(
    prefect_server: PrefectRuntime, two_boxes_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Filled]:
    """Two nights of one suite, and a run of another with a scene that cannot be read."""
    folder = tmp_path_factory.mktemp("page")
    for name in ("gallery_0", "gallery_1"):
        for data in ("gallery", "damaged"):
            shutil.copytree(two_boxes_folder / "two-boxes", folder / data / name)
    splat = next((folder / "damaged" / "gallery_1").rglob("*.ply"))
    splat.write_bytes(splat.read_bytes()[:-100])
    store, results = Store(folder / "store"), folder / "results"
    made = []
    with prefect_runtime(store, home=prefect_server.home, isolated=True):
        for name, data, by in (
            ("bench", "gallery", "hand"),
            ("bench", "gallery", "schedule"),
            ("other", "damaged", "hand"),
        ):
            suite = SuiteConfig(
                name=name,
                datasets=(DatasetChoice(name=f"folder:{folder / data}"),),
                methods=(MethodConfig(), MethodConfig(method="lift")),
                models=ModelConfig(segmenter="oracle", encoder="oracle", text_segmenter="oracle"),
            )
            made.append(run_benchmark(suite, store.root, results, started_by=by).folder)
    tracking = LocalStore(folder / "mlflow")
    for result in made:
        fill_mlflow(result, tracking.uri, patient=True)
    before = mlflow.get_tracking_uri()
    with start_server(0, store=tracking) as server:
        first, second, broken = (read_result(result)[0] for result in made)
        yield Filled(server.url, (first, second), broken)
    mlflow.set_tracking_uri(before)


@pytest.fixture(scope="module")
def found(filled: Filled) -> dict[str, object]:
    """All that the Python of the page leaves in its variables."""
    variables: dict[str, object] = {}
    assert ADDRESS in SNIPPETS[0]
    for snippet in SNIPPETS:
        exec(snippet.replace(ADDRESS, filled.url), variables)
    return variables


def search(filled: Filled, filter_string: str) -> pd.DataFrame:
    mlflow.set_tracking_uri(filled.url)
    environment = filled.nights[0].environment
    for shown, real in (
        (REVISION, _revision(filled)),
        (CPUS, f"{environment.cpu_count} CPUs"),
    ):
        filter_string = filter_string.replace(shown, real)
    return mlflow.search_runs(experiment_names=["gvr-bench"], filter_string=filter_string)


def _revision(filled: Filled) -> str:
    environment = filled.nights[0].environment
    return (environment.git_revision or "unknown")[:8] + "+" * bool(environment.git_dirty)


def test_the_page_has_the_searches() -> None:
    assert len(FILTERS) == 11
    assert len(SNIPPETS) == 8


@pytest.mark.parametrize("filter_string", FILTERS)
def test_every_filter_finds_something_but_not_everything(
    filled: Filled, filter_string: str
) -> None:
    runs = search(filled, filter_string)
    everything = search(filled, "")
    assert len(everything) == 3 * 5
    assert 0 < len(runs) <= len(everything)
    tags = dict(re.findall(r"tags\.(\w+) = '([^']+)'", filter_string))
    for tag, value in tags.items():
        assert set(runs[f"tags.{tag}"]) == {value.replace(REVISION, _revision(filled))}
    shared = ("revision", "machine")  # what all three have in common, on one machine
    assert len(runs) < len(everything) or any(name in filter_string for name in shared)


def test_a_data_set_finds_its_runs(filled: Filled) -> None:
    runs = search(filled, "dataset.name = 'gallery/gallery_0'")
    assert sorted(runs["tags.kind"]) == ["benchmark"] * 2 + ["scene"] * 4
    assert set(runs["tags.suite"]) == {"bench"}


def test_its_source_names_the_scene_and_no_place(filled: Filled) -> None:
    run = search(filled, "tags.kind = 'scene' and tags.suite = 'bench'").iloc[0]
    (given,) = mlflow.get_run(run["run_id"]).inputs.dataset_inputs
    source = mlflow.data.get_source(given.dataset).to_dict()["tags"]
    assert source["scene"] == run["tags.scene"]
    assert len(source["digest.gaussians"]) == 64
    assert "/" not in given.dataset.source
    assert {tag.key: tag.value for tag in given.tags} == {"mlflow.data.context": "evaluation"}


def test_the_latest_benchmark_is_the_second_night(filled: Filled, found: dict) -> None:
    assert found["latest"]["tags.gvr.run_id"] == filled.nights[1].run_id
    assert found["latest"]["tags.started_by"] == "schedule"
    assert len(found["scenes"]) == 4


def test_the_best_methods_are_the_best(found: dict) -> None:
    best, scenes = found["best"], found["scenes"]
    assert sorted(best["tags.scene"]) == ["gallery_0", "gallery_1"]
    for _, line in best.iterrows():
        of_scene = scenes[scenes["tags.scene"] == line["tags.scene"]]
        assert line["metrics.miou"] == of_scene["metrics.miou"].max()
        assert line["tags.method"] == "gvr-paper"


def test_a_revision_has_all_three(filled: Filled, found: dict) -> None:
    ids = {*(night.run_id for night in filled.nights), filled.broken.run_id}
    assert set(found["same_code"]["tags.gvr.run_id"]) == ids


def test_the_worst_queries_come_first(found: dict) -> None:
    worst = found["worst"]
    assert 0 < len(worst) <= 10
    assert list(worst["miou"]) == sorted(worst["miou"])
    assert worst["miou"].iloc[0] == found["queries"]["miou"].min()
    assert set(worst["text"]) <= {"a red box", "the crimson cube", "a blue box"}


def test_the_slowest_stage_is_that_of_the_record(filled: Filled, found: dict) -> None:
    seconds: dict[str, list[float]] = {}
    for scene in filled.nights[1].scenes:
        for stage in scene.stages:
            seconds.setdefault(stage.stage, []).append(stage.seconds)
    slowest = max(seconds, key=lambda name: sum(seconds[name]) / len(seconds[name]))
    assert found["stages"].index[0] == f"metrics.stage_seconds/{slowest}"


def test_what_failed_says_why(found: dict) -> None:
    failed = found["failed"]
    assert sorted(failed["tags.method"]) == ["gvr-paper", "lift"]
    assert set(failed["tags.scene"]) == {"gallery_1"}
    assert all(failed["tags.error"].str.contains("gallery_1"))


def test_the_line_over_time_has_a_point_a_night(filled: Filled, found: dict) -> None:
    over_time = found["over_time"]
    assert len(over_time) == 2
    scenes = found["scenes"]
    of_method = scenes[scenes["tags.label"] == "gvr-paper"]["metrics.miou"]
    assert list(over_time.values()) == pytest.approx([of_method.mean()] * 2)
