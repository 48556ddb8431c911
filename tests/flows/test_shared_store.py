"""The whole flow on two machines that share a bucket, and what a run says of damage it met."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from s3_server import S3Server

from flows.benchmark import BenchmarkOutcome, run_benchmark
from flows.suite import SuiteConfig
from reports.cost_sheets import cache_sheets
from reports.results_place import ResultsPlace
from tasks.prefect_runtime import PrefectRuntime, prefect_runtime
from tasks.store import Store

STAGES = ["render", "depth", "masks", "encode", "index", "query", "segment", "evaluate"]


@pytest.fixture
def bench(prefect_server: PrefectRuntime, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Run a suite as a machine of that name would, with a home of its own."""
    for variable in ("GVR_STORE", "GVR_RESULTS", "GVR_STORE_LOCAL"):
        monkeypatch.delenv(variable, raising=False)

    def run(machine: str, suite: SuiteConfig, store: str, results: str) -> BenchmarkOutcome:
        monkeypatch.setenv("GVR_HOME", str(tmp_path / machine))
        with prefect_runtime(Store(store), home=prefect_server.home, isolated=True):
            return run_benchmark(suite, store, results)

    return run


def test_the_second_machine_computes_nothing(bench, suite, s3: S3Server, tmp_path) -> None:
    bucket = s3.new_bucket()
    places = (f"s3://{bucket}/store", f"s3://{bucket}/results")
    first = bench("a", suite, *places)
    (scene,) = first.result.scenes
    assert scene.status == "completed", scene.error
    assert [t.state for t in scene.stages] == ["computed"] * 8
    second = bench("b", suite, *places)
    (scene,) = second.result.scenes
    assert [(t.stage, t.state, t.fetched) for t in scene.stages] == [
        (stage, "cached", True) for stage in STAGES
    ]
    assert second.rows == first.rows
    pictures = [(o.folder / "pictures").rglob("*.png") for o in (first, second)]
    a, b = ({p.name: p.read_bytes() for p in paths} for paths in pictures)
    assert a == b and len(a) == 4
    runs = ResultsPlace(places[1], tmp_path / "reader").names()
    assert runs == sorted([first.result.run_id, second.result.run_id])
    assert Store(places[0]).verify_shared().sound
    assert not s3.files().find(f"{bucket}/store/prefect-results")


def test_a_run_says_what_it_found_damaged(bench, suite, tmp_path) -> None:
    """Flipped, truncated, deleted, another's object, another's record, no record at all."""
    places = (str(tmp_path / "store"), str(tmp_path / "results"))
    first = bench("a", suite, *places)
    store = Store(places[0])
    keys = {t.stage: t.key for t in first.result.scenes[0].stages}
    records = {stage: store.lookup(stage, key) for stage, key in keys.items()}
    objects = {
        stage: store.path(next(iter(record.artifacts.values())))
        for stage, record in records.items()
    }
    # One pass makes both books: the depths are found damaged, and healed, as a part of it.
    objects["render"] = store.path(records["render"].artifacts["views"])
    for path in objects.values():
        path.chmod(0o644)
    data = bytearray(objects["render"].read_bytes())
    data[len(data) // 2] ^= 1
    objects["render"].write_bytes(data)
    objects["depth"].write_bytes(objects["depth"].read_bytes()[:-7])
    objects["masks"].unlink()
    objects["encode"].write_bytes(objects["query"].read_bytes())
    other = store.record_path("query", keys["query"]).read_bytes()
    store.record_path("index", keys["index"]).write_bytes(other)
    torn = store.record_path("segment", keys["segment"])
    torn.write_bytes(torn.read_bytes()[:100])
    second = bench("a", suite, *places)
    (scene,) = second.result.scenes
    states = {t.stage: t.shown_state for t in scene.stages}
    again = dict.fromkeys(["render", "masks", "encode", "index", "segment"])
    assert states == dict.fromkeys(STAGES, "cached") | dict.fromkeys(again, "recomputed (damaged)")
    assert second.rows == first.rows
    (sheet,) = cache_sheets(second.result)
    assert sheet.rows[0] == ("all", "all", "5", "3", "0", "4", "2", "5", "0")
    assert sheet.notes[0] == (
        "Found damaged or unreadable: 4 artifacts and 2 records; 5 stages computed again for it."
    )
    saved = json.loads((second.folder / "result.json").read_text())
    damage = {t["stage"]: t["damage"] for t in saved["scenes"][0]["stages"]}
    assert [d["finding"] for d in damage["index"]] == ["is the record of another stage or key"]
    assert damage["masks"][0]["finding"] == "is missing" and damage["query"] == []
    third = bench("a", suite, *places)
    (sheet,) = cache_sheets(third.result)
    assert sheet.rows == (("all", "all", "0", "8", "0", "0", "0", "0", "0"),)
    assert store.verify().sound


def test_the_command_line_works_on_urls(gvr, home, s3: S3Server, tmp_path, monkeypatch) -> None:
    bucket = s3.new_bucket()
    monkeypatch.setenv("GVR_STORE", f"s3://{bucket}/store")
    monkeypatch.setenv("GVR_RESULTS", f"s3://{bucket}/results")
    store = Store()
    assert store.root == home / "store"
    store.compute_once("demo", 1, "0" * 64, lambda: {"a": store.put_bytes("a", b"a" * 99)})
    code, out, _ = gvr("cache", "ls")
    assert code == 0 and f"Shared: demo 1; 1 objects, 0.0 MB, in s3://{bucket}/store" in out
    assert gvr("cache", "verify", "--remote")[0] == 0
    there = f"{bucket}/{store.lookup('demo', '0' * 64).artifacts['a'].path}".replace(
        bucket, f"{bucket}/store"
    )
    s3.files().pipe_file(there, b"b" * 99)
    code, out, _ = gvr("cache", "verify", "--remote")
    assert code == 1 and "has another content than its digest says" in out
    code, out, _ = gvr("cache", "push")
    assert code == 0 and "1 results put" in out
    assert gvr("cache", "verify", "--remote")[0] == 0
    code, out, _ = gvr("cache", "gc", "--remote", "--dry-run")
    assert code == 0 and "would go: 0 results, 0 objects" in out
    s3.files().pipe_file(f"{bucket}/results/20260101T000000Z-00000a/result.json", b"{}")
    code, out, err = gvr("ls")
    assert (code, err) == (0, "") and "20260101T000000Z-00000a  (not here)" in out
    s3.files().rm(f"{bucket}/results", recursive=True)
    code, _, err = gvr("show")
    assert code == 2 and "no results yet (accepted: `gvr run` makes one)" in err
    code, _, err = gvr("cache", "push", "--store", "s3://no-such-bucket/x")
    assert code == 1 and "bucket does not exist" in err
    code, _, err = gvr("cache", "ls", "--store", "nope://x")
    assert code == 2 and "Protocol not known: nope" in err
    code, _, err = gvr("cache", "push", "--store", str(tmp_path))
    assert code == 1 and "is not shared by URL" in err
