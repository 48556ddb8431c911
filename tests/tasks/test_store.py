"""The records of the store: computed once, checked on every hit, never trusted."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from gvr_core.errors import StoreError
from tasks.store import Artifact, StageOutput, StageRecord, Store, canonical_json, stage_key

DIGEST = "0" * 64


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


def write_over(path: Path, data: bytes) -> None:
    """Change a read-only object in place, as a failing disk or a careless script would."""
    path.chmod(0o644)
    path.write_bytes(data)


# Records


def counting(store: Store, calls: list[int], text: bytes = b"result"):
    def function() -> StageOutput:
        calls.append(1)
        return StageOutput({"text": store.put_bytes("text", text)}, {"count": 3})

    return function


def test_record_holds_what_was_computed_and_its_cost(store: Store) -> None:
    def function() -> StageOutput:
        block = np.ones(30_000_000)  # 240 MB
        end = time.process_time() + 0.2
        while time.process_time() < end:
            block[:1000] += 1
        return StageOutput({"sum": store.put_json("sum", float(block[-1]))}, {"count": 3})

    key = stage_key("demo", 2, {}, {})
    record, computed = store.compute_once("demo", 2, key, function)
    assert computed and record.detail == {"count": 3}
    assert (record.stage, record.version, record.key) == ("demo", 2, key)
    assert record.seconds >= 0.19 and record.cpu_seconds >= 0.19
    assert record.peak_bytes > 240e6
    assert store.lookup("demo", key) == record
    on_disk = json.loads(store.record_path("demo", key).read_text())
    assert on_disk["schema"] == 1 and on_disk["artifacts"]["sum"]["kind"] == "sum"


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="Linux only")
def test_peak_memory_is_that_of_the_stage_not_of_the_process(tmp_path: Path) -> None:
    """In a fresh process: libraries that other tests load keep freed memory for themselves."""
    code = f"""
import numpy as np
from tasks.store import Store
store = Store({str(tmp_path)!r})
np.ones(50_000_000).sum()  # 400 MB, gone before the stage begins
def put(name, size):
    make = lambda: {{"n": store.put_json("n", float(np.ones(size).sum()))}}
    return store.compute_once(name, 1, "1" * 64, make)[0]
small, large = put("small", 1), put("large", 40_000_000)
print(small.peak_of, large.peak_bytes - small.peak_bytes)
"""
    printed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    ).stdout
    peak_of, more = printed.split()
    assert peak_of == "stage" and int(more) > 250e6


def test_second_call_computes_nothing(store: Store) -> None:
    calls: list[int] = []
    first, computed = store.compute_once("demo", 1, DIGEST, counting(store, calls))
    second, again = store.compute_once("demo", 1, DIGEST, counting(store, calls))
    assert (computed, again, len(calls)) == (True, False, 1) and first == second
    assert (store.counts.hits, store.counts.misses) == (1, 1)
    _, refreshed = store.compute_once("demo", 1, DIGEST, counting(store, calls), refresh=True)
    assert refreshed and len(calls) == 2


@pytest.mark.parametrize("damage", ["deleted", "truncated", "flipped", "directory", "link"])
def test_damaged_artifact_is_a_counted_miss_and_is_healed(
    store: Store, tmp_path: Path, damage: str
) -> None:
    calls: list[int] = []
    record, _ = store.compute_once("demo", 1, DIGEST, counting(store, calls))
    path = store.path(record.artifacts["text"])
    content = path.read_bytes()
    if damage == "truncated":
        write_over(path, content[:-1])
    elif damage == "flipped":
        write_over(path, bytes([content[0] ^ 1]) + content[1:])
    else:
        path.unlink()
    if damage == "directory":
        path.mkdir()
    copy = tmp_path / "copy"
    if damage == "link":
        copy.write_bytes(content)
        path.symlink_to(copy)

    assert store.lookup("demo", DIGEST) is None
    assert (store.counts.misses, store.counts.damaged, store.counts.unreadable) == (2, 1, 0)
    if damage in ("truncated", "flipped"):
        assert not path.exists() and list((store.root / "damaged").glob(f"*{path.name}"))
    healed, computed = store.compute_once("demo", 1, DIGEST, counting(store, calls))
    assert computed and len(calls) == 2 and healed.artifacts == record.artifacts
    assert store.load_bytes(record.artifacts["text"]) == content
    assert store.lookup("demo", DIGEST) == healed
    assert not path.is_symlink() and (damage != "link" or copy.read_bytes() == content)


class Marker:
    """Unpickling this makes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


def test_hostile_records_are_misses(store: Store, tmp_path: Path) -> None:
    calls: list[int] = []
    record, _ = store.compute_once("demo", 1, DIGEST, counting(store, calls))
    path = store.record_path("demo", DIGEST)
    good = json.loads(path.read_text())
    artifact = good["artifacts"]["text"]
    marker = tmp_path / "marker"
    hostile: list[bytes] = [
        b"",
        b"{",
        b"null",
        b"\xff\xfe",
        b"[" * 100_000,
        pickle.dumps(Marker(marker)),
        json.dumps(good | {"schema": 2}).encode(),
        json.dumps(good | {"surplus": 1}).encode(),
        json.dumps(good | {"stage": "other"}).encode(),
        json.dumps(good | {"key": "1" * 64}).encode(),
        json.dumps(good | {"seconds": "NaN"}).encode(),
        json.dumps(good | {"artifacts": [artifact]}).encode(),
        json.dumps(good | {"artifacts": {"text": artifact | {"digest": "../x"}}}).encode(),
        json.dumps(good | {"artifacts": {"text": artifact | {"path": "../../passwd"}}}).encode(),
    ]
    for text in hostile:
        path.write_bytes(text)
        before = store.counts.unreadable + store.counts.damaged
        assert store.lookup("demo", DIGEST) is None
        assert store.counts.unreadable + store.counts.damaged == before + 1
    assert not marker.exists()
    again, computed = store.compute_once("demo", 1, DIGEST, counting(store, calls))
    assert computed and again.artifacts == record.artifacts


def test_a_failed_stage_leaves_no_record_and_no_lock(store: Store) -> None:
    def fails() -> dict[str, Artifact]:
        raise ArithmeticError("no good")

    with pytest.raises(ArithmeticError, match="no good"):
        store.compute_once("demo", 1, DIGEST, fails)
    assert store.lookup("demo", DIGEST) is None
    assert store.compute_once("demo", 1, DIGEST, counting(store, []))[1]


@pytest.mark.parametrize(
    ("output", "message"),
    [
        (lambda store: None, "returned NoneType"),
        (lambda store: {"a": np.zeros(3)}, "returned dict"),
        (lambda store: StageOutput({}, {"n": np.float32(1)}), "n is of type float32"),
        (lambda store: StageOutput({}, {"n": float("inf")}), "n is inf"),
        (
            lambda store: {
                "a": Artifact(kind="x", digest=DIGEST, path=f"objects/00/{DIGEST}", bytes=0)
            },
            "is not in the store",
        ),
        (
            lambda store: {"a": Artifact(kind="x", digest=DIGEST, path="/etc/passwd", bytes=0)},
            "artifact path",
        ),
    ],
)
def test_results_that_cannot_be_stored_are_errors(store: Store, output, message: str) -> None:
    with pytest.raises(StoreError, match=message):
        store.compute_once("demo", 1, DIGEST, lambda: output(store))
    assert store.lookup("demo", DIGEST) is None


def test_a_stage_that_asks_for_itself_is_an_error_not_a_deadlock(store: Store) -> None:
    def again() -> dict[str, Artifact]:
        return store.compute_once("demo", 1, DIGEST, again)[0].artifacts

    with pytest.raises(StoreError, match="asks for its own result"):
        store.compute_once("demo", 1, DIGEST, again)


def test_digest_of_a_record_is_that_of_its_contents() -> None:
    artifact = Artifact(kind="x", digest=DIGEST, path="p", bytes=1)
    other = artifact.model_copy(update={"digest": "1" * 64})
    fields = {"stage": "demo", "version": 1, "key": DIGEST, "peak_of": "stage", "created": "now"}
    cheap = StageRecord(**fields, artifacts={"a": artifact}, seconds=1, cpu_seconds=1, peak_bytes=1)
    dear = cheap.model_copy(update={"seconds": 9.0, "key": "2" * 64})
    assert cheap.digest == dear.digest
    assert cheap.digest != cheap.model_copy(update={"artifacts": {"a": other}}).digest
    assert cheap.digest != cheap.model_copy(update={"artifacts": {"b": artifact}}).digest
    assert StageRecord.from_json(canonical_json(cheap.to_json())) == cheap


# Many at once


def test_threads_that_want_one_key_compute_once(store: Store) -> None:
    calls: list[int] = []

    def slow() -> dict[str, Artifact]:
        calls.append(1)
        time.sleep(0.2)
        return {"text": store.put_bytes("text", b"x")}

    results: list[bool] = []
    threads = [
        threading.Thread(
            target=lambda: results.append(store.compute_once("demo", 1, DIGEST, slow)[1])
        )
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(calls) == 1 and sorted(results) == [False] * 7 + [True]


RACER = """
import sys, time
from pathlib import Path
from tasks.store import Store
store, log = Store(sys.argv[1]), Path(sys.argv[2])
def slow():
    with log.open("a") as file:
        file.write("computed\\n")
    time.sleep(0.5)
    return {"text": store.put_bytes("text", b"x")}
while not (log.parent / "go").exists():
    time.sleep(0.005)
print(store.compute_once("demo", 1, "0" * 64, slow)[1])
"""


def test_processes_that_want_one_key_compute_once(store: Store, tmp_path: Path) -> None:
    log = tmp_path / "log"
    command = [sys.executable, "-c", RACER, str(store.root), str(log)]
    racers = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    time.sleep(1.5)
    (tmp_path / "go").touch()
    answers = sorted(racer.communicate(timeout=30)[0].strip() for racer in racers)
    assert answers == ["False", "False", "True"]
    assert log.read_text() == "computed\n"


HOLDER = """
import os, sys, time
from pathlib import Path
from tasks.store import Store
store, flag = Store(sys.argv[1]), Path(sys.argv[2])
def hang():
    store.put_bytes("text", b"unfinished business")
    child = os.fork()  # a worker of the stage, which outlives its parent
    if child == 0:
        time.sleep(20)
        os._exit(0)
    (flag.parent / "child").write_text(str(child))
    flag.touch()
    time.sleep(60)
store.compute_once("demo", 1, "0" * 64, hang)
"""


def test_killed_holder_frees_its_lock(store: Store, tmp_path: Path) -> None:
    flag = tmp_path / "computing"
    holder = subprocess.Popen([sys.executable, "-c", HOLDER, str(store.root), str(flag)])
    child = None
    try:
        deadline = time.monotonic() + 20
        while not flag.exists():
            assert time.monotonic() < deadline and holder.poll() is None
            time.sleep(0.01)
        child = int((tmp_path / "child").read_text())
        results: list[bool] = []
        waiter = threading.Thread(
            target=lambda: results.append(
                store.compute_once("demo", 1, DIGEST, counting(store, []))[1]
            )
        )
        waiter.start()
        waiter.join(0.5)
        assert waiter.is_alive()  # the holder has it
        holder.kill()
        holder.wait()
        os.kill(child, 0)  # the worker still runs
        waiter.join(3)
        assert results == [True]
    finally:
        holder.kill()
        holder.wait()
        if child is not None:
            os.kill(child, 9)
